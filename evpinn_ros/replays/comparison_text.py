"""A comparison of drives as rows and sentences for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from evpinn_ros.estimation.breakdown import (
    DISTANCE,
    REGAINED,
    UNEXPLAINED,
    Amount,
    Breakdown,
)
from evpinn_ros.estimation.energy_parts import WHOLE, Part
from evpinn_ros.replays.breakdown_text import MEANINGS, name_of
from evpinn_ros.replays.comparison import Comparison
from evpinn_ros.replays.driven import travelled

UNIT = "kWh/100 km"
SURE = 2.0  # sigmas of a difference that is more than chance
Rows = list[tuple[str, ...]]


def part_rows(found: Sequence[Breakdown], *, signed: bool = False) -> Rows:
    """Parts and what they add up to, a column for each breakdown: `UNIT` +- 1-sigma.

    Parts that one of the breakdowns does not separate stand in one row.
    """
    rows = [
        (name_of(parts), [each.of(*parts) for each in found]) for parts in common_groups(found)
    ]
    amounts = [each.amounts() for each in found]
    rows.append((MEANINGS[UNEXPLAINED], [each[UNEXPLAINED] for each in amounts]))
    known = [row for row in rows if any(each.kwh or each.sigma_kwh for each in row[1])]
    known.append((MEANINGS["measured"], [each.total() for each in found]))
    known.append((MEANINGS[REGAINED], [each[REGAINED] for each in amounts]))
    return [
        (name, *(per_100_km(e, one.distance, signed) for e, one in zip(cells, found, strict=True)))
        for name, cells in known
    ]


def common_groups(found: Sequence[Breakdown]) -> list[tuple[Part, ...]]:
    """The parts; in one group those that any of these breakdowns does not separate."""
    rows = [{part} for part in list(Part)[WHOLE]]
    for group in [set(group) for each in found for group in each.together()]:
        joined = group.union(*(row for row in rows if row & group))
        rows = [row for row in rows if not row & group] + [joined]
    return sorted(tuple(sorted(row)) for row in rows)


def trip_rows(found: Comparison) -> Rows:
    """Length, time and mean speed of each drive, and how much of it is compared."""
    columns = []
    for drive, parts in zip(found.drives, found.parts(), strict=True):
        steps = travelled(drive)
        km, hours = float(steps.distance.sum()) / 1000, float(steps.seconds.sum()) / 3600
        columns.append(
            (
                f"{km:.1f} km",
                f"{drive.duration / 60:.0f} min",
                f"{km / hours:.0f} km/h" if hours else "-",
                f"{parts.distance / 1000:.1f} km",
            )
        )
    names = ("length", "time", "mean speed", "with battery measured")
    return [(name, *cells) for name, *cells in zip(names, *columns, strict=True)]


def sentences(found: Comparison) -> Iterator[str]:
    """Sentences on what explains the difference of each drive to the first."""
    base = found.parts()[0].total().kwh_per_100km or 0.0
    for name, difference in zip(found.names[1:], found.differences(), strict=True):
        total = difference.total().kwh
        share = f" ({100 * total / base:+.0f} %)" if base > 0.0 else ""
        if round(total, 2) == 0.0:
            yield f"{name} took as much per 100 km as {found.names[0]}."
            continue
        more = "more" if total > 0.0 else "less"
        yield f"{name} took {abs(total):.2f} {UNIT} {more} than {found.names[0]}{share}."
        yield _explained(difference)


def _explained(difference: Breakdown) -> str:
    """The parts whose difference is more than chance, the largest first."""
    parts = {group: difference.of(*group) for group in common_groups([difference])}
    sure = {g: each for g, each in parts.items() if abs(each.kwh) > SURE * each.sigma_kwh > 0.0}
    if not sure:
        return (
            "No single part differs by more than 2 sigma: which it was, these drives do not show."
        )
    largest = sorted(sure, key=lambda group: -abs(sure[group].kwh))
    listed = "; ".join(
        f"{name_of(group)} {per_100_km(sure[group], DISTANCE, signed=True)}" for group in largest
    )
    return f"More than chance: {listed}."


def per_100_km(amount: Amount, distance: float, signed: bool = False) -> str:
    """Consumption of a part over a distance, m, with its 1-sigma."""
    scale = DISTANCE / distance
    value = round(amount.kwh * scale, 2) + 0.0  # no -0.00
    return f"{value:{'+' if signed else ''}.2f} +- {amount.sigma_kwh * scale:.2f}"
