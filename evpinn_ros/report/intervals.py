"""Amounts and trends with their intervals, for the macros `intervals` and `trends`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import math
from typing import Any, NamedTuple

from evpinn_ros.common.units import METRIC, Units, counted
from evpinn_ros.replays.trends import DrivePoint, Trend, trends


class IntervalRow(NamedTuple):
    """A row: name, text beside it, amount, half of its interval, and lower limit."""

    name: str
    text: str
    value: float
    half: float
    least: float = -math.inf

    @property
    def low(self) -> float:
        """Lower end of the interval."""
        return max(self.value - self.half, self.least)


def interval_rows(rows: Sequence[IntervalRow]) -> list[dict[str, Any]]:
    """The rows with the places of bar, interval and zero, in percent of the width.

    The width holds every interval and zero, so that nothing is cut off.
    """
    low = min([0.0, *(min(row.value, row.low) for row in rows)])
    high = max([0.0, *(row.value + row.half for row in rows)])
    width = max(high - low, 1e-12)

    def at(value: float) -> float:
        return round(100.0 * (value - low) / width, 2)

    return [
        {
            "name": row.name,
            "text": row.text,
            "zero": at(0.0),
            "left": at(min(row.value, 0.0)),
            "width": round(abs(at(row.value) - at(0.0)), 2),
            "from_": at(row.low),
            "to": at(row.value + row.half),
        }
        for row in rows
    ]


def trend_intervals(
    points: Iterable[DrivePoint | None], units: Units = METRIC
) -> list[tuple[str, list[dict[str, Any]]]]:
    """Title and rows of each trend, with the spread of single drives as the interval."""
    present = [point for point in points if point is not None]
    return [(trend.title, _rows(trend, units)) for trend in trends(present, units)]


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
