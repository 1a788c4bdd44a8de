"""Contradictions of a table with itself, in words: signs and sizes of current and power."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.column import Column, column_of
from evpinn_ros.drives.quantities import QUANTITIES, score
from evpinn_ros.drives.units_by_values import LEAST_EVENTS, Signal, at_times, pull

LOADS = ("heating", "aircon", "auxiliary")
ALIKE = 0.5  # correlation of two powers from which on they are one, up to sign and size
SAME_SIZE = (0.5, 2.0)  # of the ratio of two powers that are one


def power_beside(header: Sequence[str], used: Sequence[Column]) -> Column | None:
    """A column of the battery's power that is not needed, for voltage and current are there."""
    taken = {column.quantity: column.place for column in used}
    if not {"voltage", "current"} <= taken.keys() or "power" in taken:
        return None
    scores = {place: score("power", name) for place, name in enumerate(header)}
    for place, name in enumerate(header):
        if place in taken.values() or any(score(each, name) > 0.0 for each in LOADS):
            scores[place] = 0.0
    place = max(scores, key=lambda i: scores[i])
    if scores[place] <= 0.0:
        return None
    with suppress(InputError):  # of a unit that is not known it tells nothing
        return column_of("power", header, place)
    return None


def contradictions(used: Mapping[str, Column], cells: Mapping[str, Signal]) -> Iterator[str]:
    """Sentences on columns that contradict each other, or the car.

    Args:
        used: columns with units and signs, by quantity; with voltage and current, `power` is
            compared with them.
        cells: their signals in the file's units.
    """
    signals = {name: _in_si(cells[name], column) for name, column in used.items()}
    drawn = signals.get("power")
    if {"voltage", "current"} <= signals.keys():
        current = signals["current"]
        drawn = Signal(current.time, current.value * at_times(signals["voltage"], current.time))
        if "power" in signals:
            yield from _compared(used["power"].name, signals["power"], drawn)
    if drawn is not None and pull(signals["speed"], drawn) < 0.0:
        column = used["current" if "current" in used else "power"]
        unit = column.unit.lstrip("-") or next(iter(QUANTITIES[column.quantity].units))
        turned = unit if column.unit.startswith("-") else f"-{unit}"
        yield (
            f"the car speeds up while its battery is charged: the sign of {column.name!r} is "
            f"probably wrong; --column '{column.quantity}={column.name}:{turned}' turns it"
        )


def _in_si(signal: Signal, column: Column) -> Signal:
    return Signal(signal.time, signal.value * column.factor + column.offset)


def _compared(name: str, power: Signal, drawn: Signal) -> Iterator[str]:
    """Sentences on a column of power beside voltage times current, W."""
    at = at_times(power, drawn.time)
    known = np.isfinite(at) & np.isfinite(drawn.value)
    one, other = at[known], drawn.value[known]
    if one.size < LEAST_EVENTS or not np.ptp(one) or not np.ptp(other):
        return
    alike = float(np.corrcoef(one, other)[0, 1])
    if abs(alike) < ALIKE:
        yield f"{name!r} has little in common with voltage times current, which are used"
        return
    ratio = float(np.std(one) / np.std(other))
    if alike < 0.0:
        yield f"{name!r} has the other sign than voltage times current, which are used"
    if not SAME_SIZE[0] < ratio < SAME_SIZE[1]:
        yield f"{name!r} is {ratio:.2g} times voltage times current, which are used"
