"""The page of a comparison: drives of one car side by side, without a script."""

from __future__ import annotations

from collections.abc import Sequence
import math
from pathlib import Path
from typing import Any

import numpy as np

from evpinn_ros.common.units import METRIC, Units
from evpinn_ros.estimation.breakdown import Breakdown
from evpinn_ros.replays.breakdown_text import name_of
from evpinn_ros.replays.comparison import Comparison
from evpinn_ros.replays.comparison_text import (
    common_groups,
    part_rows,
    rate_text,
    sentences,
    trip_rows,
)
from evpinn_ros.replays.over_distance import over_distance
from evpinn_ros.report.html import write_page

POINTS = 400  # of a curve: more than a narrow page has pixels
MOST_TICKS = 6
CURVES = {
    "energy": "Energy measured since the start, kWh",
    "speed": "Speed, {units.speed}",
    "height": "Height, {units.height}",
}


def write_comparison(path: Path, found: Comparison, command: str, units: Units = METRIC) -> None:
    """Write the page.

    Args:
        path: of the new file.
        found: what to show.
        command: that made it, text.
        units: of distances.

    Raises:
        OSError: it cannot be written.
    """
    parts = found.parts()
    write_page(
        path,
        "compare.html.j2",
        title=f"{' and '.join(found.names)} compared",
        command=command,
        unit=units.rate,
        names=found.names,
        vehicle=found.vehicle.name,
        sentences=list(sentences(found, units)),
        rows=trip_rows(found, units) + part_rows(parts, units=units),
        bars=_bars(found.names, parts, units),
        differences=[
            (
                name,
                _whiskers(difference, units),
                part_rows([difference], signed=True, units=units),
            )
            for name, difference in zip(found.names[1:], found.differences(), strict=True)
        ],
        distance=units.distance,
        curves=_curves(found, units),
    )


def _bars(names: Sequence[str], parts: Sequence[Breakdown], units: Units) -> list[dict[str, Any]]:
    """Parts that took energy of each drive, side by side: widths in percent of the longest bar."""
    groups = common_groups(parts)
    sizes = [[one.of(*group) for group in groups] for one in parts]
    longest = max(
        sum(max(each.kwh, 0.0) for each in amounts) / one.distance
        for one, amounts in zip(parts, sizes, strict=True)
    )
    return [
        {
            "name": name,
            "boxes": [
                {
                    "colour": int(group[0]),
                    "width": round(100.0 * each.kwh / one.distance / longest, 2),
                    "words": f"{name_of(group)} {rate_text(each, one.distance, units=units)}",
                }
                for group, each in zip(groups, amounts, strict=True)
                if each.kwh > 0.0
            ],
        }
        for name, one, amounts in zip(names, parts, sizes, strict=True)
    ]


def _whiskers(difference: Breakdown, units: Units) -> list[dict[str, Any]]:
    """A bar with its 1-sigma for each part, in percent of the width; zero is at `zero`."""
    rows = [(name_of(group), difference.of(*group)) for group in common_groups([difference])]
    rows = [row for row in rows if row[1].kwh or row[1].sigma_kwh]
    low = min([0.0, *(each.kwh - each.sigma_kwh for _, each in rows)])
    high = max([0.0, *(each.kwh + each.sigma_kwh for _, each in rows)])

    def at(kwh: float) -> float:
        return round(100.0 * (kwh - low) / (high - low), 2)

    return [
        {
            "name": name,
            "text": rate_text(each, difference.distance, True, units),
            "zero": at(0.0),
            "left": min(at(each.kwh), at(0.0)),
            "width": abs(at(each.kwh) - at(0.0)),
            "from_": at(each.kwh - each.sigma_kwh),
            "to": at(each.kwh + each.sigma_kwh),
        }
        for name, each in sorted(rows, key=lambda row: -abs(row[1].kwh))
    ]


def _curves(found: Comparison, units: Units) -> list[dict[str, Any]]:
    """Lines over distance in a box of 1000 by 1000, with the ticks of both axes in percent."""
    courses = [over_distance(drive, POINTS, units) for drive in found.drives]
    across = ticks(0.0, max(float(course.distance[-1]) for course in courses))
    curves = []
    for key, title in CURVES.items():
        lines = [getattr(course, key) for course in courses]
        known = np.concatenate([line[np.isfinite(line)] for line in lines])
        if not len(known):
            continue
        low = float(known.min()) if key == "height" else min(0.0, float(known.min()))
        up = ticks(low, float(known.max()))
        points = [
            " ".join(
                f"{1000 * _share(x, across):.0f},{1000 - 1000 * _share(y, up):.0f}"
                for x, y in zip(course.distance, line, strict=True)
                if math.isfinite(y)
            )
            for course, line in zip(courses, lines, strict=True)
        ]
        curves.append(
            {
                "title": title.format(units=units),
                "lines": points,
                "across": [(f"{each:g}", round(100 * _share(each, across), 2)) for each in across],
                "up": [(f"{each:g}", round(100 * _share(each, up), 2)) for each in up],
            }
        )
    return curves


def ticks(low: float, high: float) -> list[float]:
    """Round values of an axis, at most `MOST_TICKS`, that hold both ends."""
    span = max(high - low, 1e-3)
    size = 10.0 ** math.floor(math.log10(span))
    step = next(
        step
        for step in (size * each for each in (0.2, 0.5, 1.0, 2.0, 5.0))
        if math.ceil(high / step) - math.floor(low / step) < MOST_TICKS
    )
    first, last = math.floor(low / step), math.ceil(high / step)
    return [round(i * step, 10) for i in range(first, max(last, first + 1) + 1)]


def _share(value: float, axis: Sequence[float]) -> float:
    return (value - axis[0]) / (axis[-1] - axis[0])
