"""Columns of a table that are not used, and why."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from evpinn_ros.drives.column import Column
from evpinn_ros.drives.quantities import score, speaks_of

EMPTY = "empty"
NO_USE = "not needed"
OF_PARTS = {
    "voltage": "not of the whole traction battery",
    "current": "not of the whole traction battery",
    "power": "not of the whole traction battery",
    "speed": "not the speed of the car",
}


def unused_columns(
    header: Sequence[str], used: Sequence[Column], clock: Collection[int], empty: Collection[int]
) -> dict[str, str]:
    """Names of the columns that are not used, in the order of the file, each with the reason.

    Args:
        header: names of all columns.
        used: those that are used.
        clock: places of those that the time is read from.
        empty: places of those without a cell.
    """
    taken = {column.quantity: column for column in used}
    places = {*(column.place for column in used), *clock}
    return {
        name: EMPTY if place in empty else _reason(name, taken)
        for place, name in enumerate(header)
        if name and place not in places
    }


def _reason(name: str, taken: Mapping[str, Column]) -> str:
    for quantity, column in taken.items():
        if score(quantity, name) > 0.0:
            return f"{quantity} is read from {column.name!r}"
    if score("power", name) > 0.0 and {"voltage", "current"} <= taken.keys():
        return "power is voltage times current"
    parts = (why for quantity, why in OF_PARTS.items() if speaks_of(quantity, name))
    return next(parts, NO_USE)


def by_reason(unused: Mapping[str, str]) -> dict[str, list[str]]:
    """Names by the reason why they are not used."""
    found: dict[str, list[str]] = {}
    for name, why in unused.items():
        found.setdefault(why, []).append(name)
    return found
