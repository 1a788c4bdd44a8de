"""The page of a comparison: drives of one car side by side, without a script."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from evpinn_ros.common.units import METRIC, Units
from evpinn_ros.core.estimation.breakdown import Breakdown
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.replays.comparison import Comparison
from evpinn_ros.replays.over_distance import over_distance
from evpinn_ros.report.breakdown_text import name_of
from evpinn_ros.report.comparison_text import (
    common_groups,
    part_rows,
    rate_text,
    sentences,
    trip_rows,
)
from evpinn_ros.report.curves import Curve, curve
from evpinn_ros.report.html import write_page
from evpinn_ros.report.intervals import IntervalRow, interval_rows

POINTS = 400  # of a curve: more than a narrow page has pixels
CURVES = {
    "energy": "Energy measured since the start, kWh",
    "speed": "Speed, {units.speed}",
    "height": "Height, {units.height}",
}


def write_comparison(
    path: Path, comparison: Comparison, command: str, units: Units = METRIC
) -> None:
    """Write the page.

    Args:
        path: of the new file.
        comparison: what to show.
        command: that made it, text.
        units: of distances.

    Raises:
        OSError: it cannot be written.
    """
    parts = comparison.parts()
    write_page(
        path,
        "compare.html.j2",
        title=f"{' and '.join(comparison.names)} compared",
        command=command,
        unit=units.rate,
        names=comparison.names,
        vehicle=comparison.vehicle.name,
        sentences=list(sentences(comparison, units)),
        rows=trip_rows(comparison, units) + part_rows(parts, units=units),
        bars=_bars(comparison.names, parts, units),
        differences=[
            (
                name,
                _whiskers(difference, units),
                part_rows([difference], signed=True, units=units),
            )
            for name, difference in zip(
                comparison.names[1:], comparison.differences(), strict=True
            )
        ],
        distance=units.distance,
        curves=_curves(comparison, units),
    )


def _bars(names: Sequence[str], parts: Sequence[Breakdown], units: Units) -> list[dict[str, Any]]:
    """Parts that took energy of each drive, side by side: widths in percent of the longest bar."""
    groups = common_groups(parts)
    sizes = [[breakdown.of(*group) for group in groups] for breakdown in parts]
    longest = max(
        sum(max(amount.kwh, 0.0) for amount in amounts) / breakdown.distance
        for breakdown, amounts in zip(parts, sizes, strict=True)
    )
    return [
        {
            "name": name,
            "boxes": [
                {
                    "colour": int(group[0]),
                    "width": round(100.0 * amount.kwh / breakdown.distance / longest, 2),
                    "words": f"{name_of(group)} "
                    f"{rate_text(amount, breakdown.distance, units=units)}",
                }
                for group, amount in zip(groups, amounts, strict=True)
                if amount.kwh > 0.0
            ],
        }
        for name, breakdown, amounts in zip(names, parts, sizes, strict=True)
    ]


def _whiskers(difference: Breakdown, units: Units) -> list[dict[str, Any]]:
    """A bar with its 90 % interval for each part, the biggest first."""
    rows = [(name_of(group), difference.of(*group)) for group in common_groups([difference])]
    rows = [row for row in rows if row[1].kwh or row[1].sigma_kwh]
    rows.sort(key=lambda row: -abs(row[1].kwh))
    return interval_rows(
        [
            IntervalRow(
                name,
                rate_text(amount, difference.distance, True, units),
                amount.kwh,
                GAUSSIAN_QUANTILE * amount.sigma_kwh,
            )
            for name, amount in rows
        ]
    )


def _curves(comparison: Comparison, units: Units) -> list[dict[str, Any]]:
    """Energy, speed and height of all drives over distance."""
    courses = [over_distance(drive, POINTS, units) for drive in comparison.drives]
    curves = [
        curve(
            title.format(units=units),
            [Curve(course.distance, getattr(course, key)) for course in courses],
            from_zero=key != "height",
        )
        for key, title in CURVES.items()
    ]
    return [drawn for drawn in curves if drawn is not None]
