"""A comparison of drives as rows and sentences for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, Units
from evpinn_ros.core.estimation.breakdown import (
    DIFFERENCE_METRES,
    REGAINED,
    UNEXPLAINED,
    Amount,
    Breakdown,
)
from evpinn_ros.core.estimation.terms import WHOLE, Part
from evpinn_ros.replays.comparison import Comparison
from evpinn_ros.replays.driven import travelled
from evpinn_ros.replays.energy_metrics import MEANINGS
from evpinn_ros.report.breakdown_text import name_of

SURE = 2.0  # sigmas of a difference that is statistically significant
Rows = list[tuple[str, ...]]


def part_rows(
    breakdowns: Sequence[Breakdown], *, signed: bool = False, units: Units = METRIC
) -> Rows:
    """Parts and what they add up to, a column for each breakdown: `units.rate` +- 1-sigma.

    Parts that one of the breakdowns does not separate stand in one row.
    """
    rows = [
        (name_of(parts), [breakdown.of(*parts) for breakdown in breakdowns])
        for parts in common_groups(breakdowns)
    ]
    amounts = [breakdown.amounts() for breakdown in breakdowns]
    rows.append((MEANINGS[UNEXPLAINED], [amount[UNEXPLAINED] for amount in amounts]))
    known = [row for row in rows if any(amount.kwh or amount.sigma_kwh for amount in row[1])]
    known.append((MEANINGS["measured"], [breakdown.total() for breakdown in breakdowns]))
    known.append((MEANINGS[REGAINED], [amount[REGAINED] for amount in amounts]))
    return [
        (
            name,
            *(
                rate_text(amount, breakdown.distance, signed, units)
                for amount, breakdown in zip(cells, breakdowns, strict=True)
            ),
        )
        for name, cells in known
    ]


def common_groups(breakdowns: Sequence[Breakdown]) -> list[tuple[Part, ...]]:
    """The parts; in one group those that any of these breakdowns does not separate."""
    rows = [{part} for part in list(Part)[WHOLE]]
    for group in [set(group) for breakdown in breakdowns for group in breakdown.together()]:
        joined = group.union(*(row for row in rows if row & group))
        rows = [row for row in rows if not row & group] + [joined]
    return sorted(tuple(sorted(row)) for row in rows)


def trip_rows(comparison: Comparison, units: Units = METRIC) -> Rows:
    """Length, time and mean speed of each drive, and how much of it is compared."""
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
        share = f" ({100 * total / base:+.0f} %)" if base > 0.0 else ""
        if round(total, 2) == 0.0:
            yield f"{name} took as much over distance as {comparison.names[0]}."
            continue
        more = "more" if total > 0.0 else "less"
        much = abs(total) * METRIC.rate_joules / units.rate_joules
        text = f"{much:.{_digits(units)}f} {units.rate}"
        yield f"{name} took {text} {more} than {comparison.names[0]}{share}."
        yield _explained(difference, units)


def _explained(difference: Breakdown, units: Units) -> str:
    """The parts whose difference is statistically significant, the largest first."""
    parts = {group: difference.of(*group) for group in common_groups([difference])}
    sure = {
        g: amount for g, amount in parts.items() if abs(amount.kwh) > SURE * amount.sigma_kwh > 0.0
    }
    if not sure:
        return "No single part differs by more than 2 sigma: these drives do not show the cause."
    largest = sorted(sure, key=lambda group: -abs(sure[group].kwh))
    listed = "; ".join(
        f"{name_of(group)} {rate_text(sure[group], DIFFERENCE_METRES, True, units)}"
        for group in largest
    )
    return f"Statistically significant: {listed}."


def rate_text(amount: Amount, distance: float, signed: bool = False, units: Units = METRIC) -> str:
    """Consumption of a part over a distance, m, with its 1-sigma, in `units.rate`."""
    digits, sign = _digits(units), "+" if signed else ""
    scale = JOULES_PER_KWH / distance / units.rate_joules
    value = round(amount.kwh * scale, digits) + 0.0  # no -0.00
    return f"{value:{sign}.{digits}f} +- {amount.sigma_kwh * scale:.{digits}f}"


def _digits(units: Units) -> int:
    return 2 if units is METRIC else 1
