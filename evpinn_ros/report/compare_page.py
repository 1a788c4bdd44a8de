"""Rows, sentences and a page that compare drives of one car."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, Units, fixed
from evpinn_ros.core.estimation.breakdown import (
    DIFFERENCE_METRES,
    REGAINED,
    UNEXPLAINED,
    Amount,
    Breakdown,
)
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.core.estimation.terms import WHOLE, Part
from evpinn_ros.replays.comparison import Comparison, over_distance
from evpinn_ros.replays.driven import travelled
from evpinn_ros.replays.energy_metrics import MEANINGS
from evpinn_ros.report.breakdown_text import listed, name_of
from evpinn_ros.report.html import write_page
from evpinn_ros.report.shapes import Curve, IntervalRow, curve, interval_rows

SURE = 2.0  # sigmas beyond which a part explains a difference
WORTH_NAMING = 0.1  # of the difference; smaller parts against it, or unknown, are not named
GREY = 8  # colour of no part, in page.css
Rows = list[tuple[str, ...]]


def part_rows(
    breakdowns: Sequence[Breakdown], *, signed: bool = False, units: Units = METRIC
) -> Rows:
    """Parts and their sum, a column per breakdown; parts that one does not separate are joined."""
    rows = [
        (name_of(parts), [breakdown.of(*parts) for breakdown in breakdowns])
        for parts in common_groups(breakdowns)
    ]
    amounts = [breakdown.amounts() for breakdown in breakdowns]
    rows.append((MEANINGS[UNEXPLAINED], [amount[UNEXPLAINED] for amount in amounts]))
    shown_rows = [row for row in rows if any(amount.kwh or amount.sigma_kwh for amount in row[1])]
    shown_rows.append((MEANINGS["measured"], [breakdown.total() for breakdown in breakdowns]))
    shown_rows.append((MEANINGS[REGAINED], [amount[REGAINED] for amount in amounts]))
    return [
        (
            name,
            *(
                rate_text(amount, breakdown.distance, signed, units)
                for amount, breakdown in zip(cells, breakdowns, strict=True)
            ),
        )
        for name, cells in shown_rows
    ]


def common_groups(breakdowns: Sequence[Breakdown]) -> list[tuple[Part, ...]]:
    """All parts, those together in one group that one of the breakdowns does not separate."""
    rows = [{part} for part in list(Part)[WHOLE]]
    for group in [set(group) for breakdown in breakdowns for group in breakdown.together()]:
        joined = group.union(*(row for row in rows if row & group))
        rows = [row for row in rows if not row & group] + [joined]
    return sorted(tuple(sorted(row)) for row in rows)


def trip_rows(comparison: Comparison, units: Units = METRIC) -> Rows:
    """Distance, time, mean speed and compared distance, a column per drive."""
    columns = []
    for drive, parts in zip(comparison.drives, comparison.parts(), strict=True):
        steps = travelled(drive)
        far, hours = float(steps.distance.sum()) / units.metres, float(steps.seconds.sum()) / 3600
        columns.append(
            (
                f"{far:.1f} {units.distance}",
                f"{drive.duration / 60:.0f} min",
                f"{far / hours:.0f} {units.speed}" if hours else "-",
                f"{parts.distance / units.metres:.1f} {units.distance}",
            )
        )
    names = ("length", "time", "mean speed", "with battery measured")
    return [(name, *cells) for name, *cells in zip(names, *columns, strict=True)]


def sentences(comparison: Comparison, units: Units = METRIC) -> Iterator[str]:
    """Sentences on what explains the difference of each drive to the first."""
    base = comparison.parts()[0].total().kwh_per_100km or 0.0
    for name, difference in zip(comparison.names[1:], comparison.differences(), strict=True):
        total = difference.total().kwh
        share = f" ({fixed(100 * total / base, 0, '+')} %)" if base > 0.0 else ""
        if round(total, 2) == 0.0:
            yield f"{name} took as much over distance as {comparison.names[0]}."
            continue
        more = "more" if total > 0.0 else "less"
        much = abs(total) * METRIC.rate_joules / units.rate_joules
        text = f"{much:.{_digits(units)}f} {units.rate}"
        yield f"{name} took {text} {more} than {comparison.names[0]}{share}."
        yield _explained(difference, units)


def _explained(difference: Breakdown, units: Units) -> str:
    """Sentences on parts that explain a difference, those against it, and those not known."""
    total = difference.total().kwh
    parts = [(name_of(group), difference.of(*group)) for group in common_groups([difference])]
    parts = [part for part in parts if _is_shown(part[1], units)]
    parts.sort(key=lambda part: -abs(part[1].kwh))
    sure = [part for part in parts if abs(part[1].kwh) > SURE * part[1].sigma_kwh > 0.0]
    least = WORTH_NAMING * abs(total)

    def named(sign: float, at_least: float) -> list[str]:
        scale = sign * JOULES_PER_KWH / DIFFERENCE_METRES / units.rate_joules
        word = "more" if sign > 0.0 else "less"
        return [
            f"{name} ({fixed(scale * amount.kwh, _digits(units))} {word})"
            for name, amount in sure
            if sign * amount.kwh > at_least
        ]

    sign = 1.0 if total > 0.0 else -1.0
    explained, against = named(sign, 0.0), named(-sign, least)
    rest = difference.amounts()[UNEXPLAINED]
    known_rest = abs(rest.kwh) > max(least, SURE * rest.sigma_kwh)
    rest_text = rate_text(rest, difference.distance, True, units)
    open_parts = [
        name
        for name, amount in parts
        if (name, amount) not in sure and max(abs(amount.kwh), amount.sigma_kwh) > least
    ]
    sentences = [
        f"Explained by {listed(explained)}."
        if explained
        else "No part explains it beyond 2 sigma: these drives do not show why.",
        f"Against that: {listed(against)}." if against else "",
        f"Not known well enough: {', '.join(open_parts)}." if open_parts else "",
        f"The model of the car leaves {rest_text} unexplained." if known_rest else "",
    ]
    return " ".join(filter(None, sentences))


def _is_shown(amount: Amount, units: Units) -> bool:
    """Whether a part of a difference, or its 1-sigma, does not round to zero."""
    scale = JOULES_PER_KWH / DIFFERENCE_METRES / units.rate_joules
    return any(round(kwh * scale, _digits(units)) for kwh in (amount.kwh, amount.sigma_kwh))


def rate_text(amount: Amount, distance: float, signed: bool = False, units: Units = METRIC) -> str:
    """Energy of a part over a distance, m, with its 1-sigma, in `units.rate`."""
    digits, scale = _digits(units), JOULES_PER_KWH / distance / units.rate_joules
    value = fixed(amount.kwh * scale, digits, "+" if signed else "")
    return f"{value} +- {amount.sigma_kwh * scale:.{digits}f}"


def _digits(units: Units) -> int:
    return 2 if units is METRIC else 1


POINTS = 400  # of a curve: more than a narrow page has pixels
CURVES = {
    "energy": "Energy measured since the start, kWh",
    "speed": "Speed, {units.speed}",
    "height": "Height, {units.height}",
}


def write_comparison(
    path: Path, comparison: Comparison, command: str, units: Units = METRIC
) -> None:
    """Write the page; OSError if it cannot be written."""
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
            (name, _whiskers(difference, units), part_rows([difference], signed=True, units=units))
            for name, difference in zip(
                comparison.names[1:], comparison.differences(), strict=True
            )
        ],
        distance=units.distance,
        curves=_curves(comparison, units),
    )


def _amounts(
    breakdown: Breakdown, groups: Iterable[Sequence[Part]]
) -> list[tuple[int, str, Amount]]:
    """Colour, name and amount of each part, and of the energy that no part explains."""
    parts = [(int(group[0]), name_of(group), breakdown.of(*group)) for group in groups]
    return [*parts, (GREY, MEANINGS[UNEXPLAINED], breakdown.amounts()[UNEXPLAINED])]


def _bars(names: Sequence[str], parts: Sequence[Breakdown], units: Units) -> list[dict[str, Any]]:
    groups = common_groups(parts)
    sizes = [_amounts(breakdown, groups) for breakdown in parts]
    longest = max(
        sum(max(amount.kwh, 0.0) for *_, amount in amounts) / breakdown.distance
        for breakdown, amounts in zip(parts, sizes, strict=True)
    )
    return [
        {
            "name": name,
            "boxes": [
                {
                    "colour": colour,
                    "width": round(100.0 * amount.kwh / breakdown.distance / longest, 2),
                    "words": f"{part} {rate_text(amount, breakdown.distance, units=units)}",
                }
                for colour, part, amount in amounts
                if amount.kwh > 0.0
            ],
        }
        for name, breakdown, amounts in zip(names, parts, sizes, strict=True)
    ]


def _whiskers(difference: Breakdown, units: Units) -> list[dict[str, Any]]:
    rows = [row[1:] for row in _amounts(difference, common_groups([difference]))]
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
