"""Trends over many drives as rows for the macro `trends`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from evpinn_ros.common.units import METRIC, Units, counted
from evpinn_ros.replays.trends import DrivePoint, Trend, trends
from evpinn_ros.report.intervals import IntervalRow, interval_rows


def trend_intervals(
    points: Iterable[DrivePoint | None], units: Units = METRIC
) -> list[tuple[str, list[dict[str, Any]]]]:
    """Title and rows of each trend, with the spread of single drives as the interval."""
    known = [point for point in points if point is not None]
    return [(trend.title, _rows(trend, units)) for trend in trends(known, units)]


def _rows(trend: Trend, units: Units) -> list[dict[str, Any]]:
    rows = []
    for row in trend.rows:
        text = f"{row.mean:.{trend.digits}f}"
        if row.drives > 1:
            text += f" (single drives ± {row.spread:.{trend.digits}f})"
        distance = f"{row.distance / units.metres:.0f} {units.distance}"
        text += f"; {counted(row.drives, 'drive')}, {distance}"
        rows.append(IntervalRow(row.name, text, row.mean, row.spread))
    return interval_rows(rows)
