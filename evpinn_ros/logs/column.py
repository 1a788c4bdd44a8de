"""Columns of a table: those used, by name or by choice, and why others are not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
import math

import numpy as np

from evpinn_ros.common.errors import InputError, near_names
from evpinn_ros.logs.apps import app_of
from evpinn_ros.logs.quantities import (
    BACK,
    BRAKED,
    BY_COLUMN,
    NEEDED,
    QUANTITIES,
    Unit,
    known_unit,
    score,
    speaks_of,
    unit_of,
    words_of,
)
from evpinn_ros.logs.signal import FloatArray, Signal

SIGNED = ("current", "power")
# Names of drawn and returned energy differ by one of these and one of `BACK`.
DRAWN = ("discharge", "discharging", "discharged", "drive", "drawn", "consumed", "out", "output")
UNIT_WORDS, VALUE_WORDS = {"unit", "units", "einheit", "uom"}, {"value", "val", "wert"}
LONGEST_LIST = 200  # characters of column names in a message
EMPTY = "empty"
NO_USE = "not needed"
HEALTH = "the state of health is counted from energy and charge"
OF_PARTS = {
    "voltage": "not of the whole traction battery",
    "current": "not of the whole traction battery",
    "power": "not of the whole traction battery",
    "speed": "not the speed of the car",
}


@dataclass(frozen=True, slots=True)
class Column:
    """A column in use."""

    quantity: str  # of `QUANTITIES`
    name: str  # in the file
    factor: float = 1.0  # to SI
    unit: str = ""  # of the file, with a minus if the sign is turned
    why: str = ""  # source of the unit, for people; empty if the name is one of ours
    offset: float = 0.0  # to SI, added after the factor
    place: int = 0  # of the column in the file, from 0
    wraps: float = 0.0  # in the file's unit: span of numbers whose upper half is negative
    could_be: tuple[str, ...] = ()  # other units that fit as well: the unit is assumed
    # for current or power that is only drawn: index of the returned one, in the same unit
    back: int | None = None

    @property
    def has_unit(self) -> bool:
        """True if its unit is known: written, given, decided by values, or by our own name."""
        return bool(self.unit) or self.is_ours

    @property
    def is_ours(self) -> bool:
        """True if its name is one of ours, which implies unit and sign."""
        return self.name == QUANTITIES[self.quantity].column

    def measured_in(self, text: str, unit: Unit, why: str) -> Column:
        """The column with a known unit."""
        return replace(self, factor=unit.factor, offset=unit.offset, unit=text, why=why)

    @property
    def turned_unit(self) -> str:
        """The unit for `--column` that turns the sign."""
        unit = self.unit.lstrip("-") or next(iter(QUANTITIES[self.quantity].units))
        return unit if self.unit.startswith("-") else f"-{unit}"

    def turned(self) -> Column:
        """The column with the opposite sign."""
        return replace(self, factor=-self.factor, offset=-self.offset, unit=f"-{self.unit}")

    def si(self, numbers: FloatArray) -> FloatArray:
        """SI values of the file's numbers; the upper half of those that wrap is negative."""
        if self.wraps:
            numbers = np.where(numbers > 0.5 * self.wraps, numbers - self.wraps, numbers)
        return numbers * self.factor + self.offset

    def in_si(self, signal: Signal) -> Signal:
        """The column's signal in SI, from one in the file's unit."""
        return Signal(signal.time, self.si(signal.value))

    def guessed(self, others: Sequence[str]) -> Column:
        """The column with an assumed unit, as the `others` fit as well."""
        return replace(self, could_be=tuple(others))

    @property
    def basis(self) -> str:
        """Basis of unit and sign: `named`, `given`, `measured` or `assumed`."""
        if self.could_be:
            return "assumed"
        if self.is_ours or self.why.startswith(("by its name", "as in logs")):
            return "named"
        return "given" if self.why == "as given" else "measured"

    @property
    def assumption(self) -> str:
        """The assumption, and how to override it; empty without one."""
        if not self.could_be:
            return ""
        turns = self.could_be[0] == self.turned_unit
        sign = "-" if self.unit.startswith("-") and not turns else ""
        option = f"--column '{self.quantity}={self.name}:{sign}{self.could_be[0]}'"
        if turns:
            return f"{self.quantity}: the sign of {self.name!r} is assumed; {option} turns it"
        return (
            f"{self.quantity}: {self.name!r} is assumed to be in {self.unit.lstrip('-')}, "
            f"and could be in {' or '.join(self.could_be)}; {option} sets that"
        )

    def in_unit(self, text: str, why: str) -> Column:
        """The column in a unit of its quantity, as `QUANTITIES` spells it."""
        return self.measured_in(text, QUANTITIES[self.quantity].units[text], why)


def columns_by_name(
    header: Sequence[str], chosen: Sequence[str], empty: Collection[int] = ()
) -> list[Column]:
    """The columns in use, and all candidates for the time; those at `empty` are not guessed.

    A choice is `speed=NAME`, `speed=NAME:UNIT`, `:-UNIT` with a turned sign, or
    `time=NAME:FORMAT`. InputError: a choice names no quantity, column or unit, or the unit of a
    needed column is unknown.
    """
    ours = [
        Column(BY_COLUMN[name], name, place=i)
        for i, name in enumerate(header)
        if name in BY_COLUMN
    ]
    given = [_chosen(text, header) for text in chosen]
    quantities = {column.quantity for column in given}
    columns = [column for column in ours if column.quantity not in quantities] + given
    for name, count in Counter(column.name for column in ours).items():
        if count > 1:
            raise InputError(f"column {name!r} is there twice; rename one")
    quantities = {column.quantity for column in columns}
    taken = {column.place for column in columns} | set(unit_places(header).values())
    app = app_of(header)
    # If our own names cover all that is needed, no other column is guessed for it.
    decided = quantities | (NEEDED if is_complete(quantities) else frozenset())
    for quantity in QUANTITIES:
        if quantity in decided:
            continue
        best_name = app.columns.get(quantity) if app else None
        if quantity == "time":
            columns += [
                column_of(quantity, header, i)
                for i, name in enumerate(header)
                if i not in taken and (name == best_name or score(quantity, name) > 0)
            ]
            continue
        # Power is voltage times current; then a foreign column of power is not needed.
        if quantity == "power" and {"voltage", "current"} <= quantities:
            continue
        best = _best_place(quantity, header, taken | {*empty}, best_name)
        if best is not None:
            column = column_of(quantity, header, best)
            columns.append(replace(column, back=_flows_back(quantity, header, best)))
            quantities.add(quantity)
            taken.add(best)
    return columns


def _best_place(
    quantity: str, header: Sequence[str], taken: Collection[int], best_name: str | None
) -> int | None:
    """Index of the column whose name fits a quantity best, or None; never one of `taken`.

    A column in a unit that the quantity does not have is chosen only for a needed quantity.
    """
    scores = {
        i: math.inf if name == best_name else score(quantity, name)
        for i, name in enumerate(header)
        if i not in taken and (quantity in NEEDED or not _foreign(quantity, name))
    }
    best = max(scores, key=lambda i: scores[i], default=None)
    return best if best is not None and scores[best] > 0 else None


def unit_places(header: Sequence[str]) -> dict[int, int]:
    """Indices of columns that hold the unit of another column, by that column's index."""
    names = [words_of(name)[0].split() for name in header]
    bare = [tuple(w for w in words if w not in UNIT_WORDS | VALUE_WORDS) for words in names]
    units = {
        bare[i]: i for i, words in enumerate(names) if bare[i] and UNIT_WORDS.intersection(words)
    }
    units_of = ((i, units.get(name)) for i, name in enumerate(bare))
    return {i: place for i, place in units_of if place not in (None, i)}


def _flows_back(quantity: str, header: Sequence[str], place: int) -> int | None:
    """Index of the column of returned energy with otherwise the same name, or None."""
    if quantity not in SIGNED:
        return None
    names = [words_of(name) for name in header]
    words, brackets = names[place]
    opposites = {words.replace(f" {drawn} ", f" {back} ") for drawn, back in product(DRAWN, BACK)}
    for i, (other, unit) in enumerate(names):
        drawn = {other.replace(f" {back} ", " ") for back in BRAKED}
        if unit == brackets and other != words and (words in drawn or other in opposites):
            return i
    return None


def _foreign(quantity: str, name: str) -> str:
    """The unit in brackets in a name if the quantity does not have it; else empty."""
    text, unit = unit_of(quantity, name)
    return text if unit is None else ""


def is_complete(quantities: set[str]) -> bool:
    """True if the quantities include all that is needed."""
    battery = "power" in quantities or {"voltage", "current"} <= quantities
    return battery and {"time", "speed"} <= quantities


def check_columns(
    columns: Sequence[Column], header: Sequence[str], *, battery: bool = True
) -> None:
    """Raise InputError for a table without time, speed or battery, naming the option."""
    quantities = {column.quantity for column in columns}
    there = f"there are {', '.join(filter(None, header))[:LONGEST_LIST] or 'none'}"
    if missing := [name for name in ("time", "speed") if name not in quantities]:
        say = " ".join(f"--column {name}=NAME" for name in missing)
        raise InputError(f"no column of {' and '.join(missing)}; {there}; say {say}")
    if battery and not is_complete(quantities):
        say = "--column voltage=NAME --column current=NAME, or --column power=NAME"
        single = [name for name in ("voltage", "current") if name in quantities]
        lacks = f"only a column of {single[0]}" if single else "no columns of voltage and current"
        raise InputError(f"{lacks}, and none of power; {there}; say {say}")


def _chosen(text: str, header: Sequence[str]) -> Column:
    quantity, _, rest = text.partition("=")
    if quantity not in QUANTITIES or not rest:
        quantities = ", ".join(QUANTITIES)
        near = near_names(quantity, QUANTITIES)
        raise InputError(
            f"--column {text}{near}: say QUANTITY=NAME or QUANTITY=NAME:UNIT, with {quantities}"
        )
    # Take the longest matching name: names and formats may contain colons.
    names = sorted((name for name in header if rest.startswith(f"{name}:")), key=len)
    name = rest if rest in header or not names else names[-1]
    unit = rest[len(name) + 1 :]
    if name not in header:
        near = near_names(rest.partition(":")[0], header)
        raise InputError(f"--column {text}: no such column{near}; there are {', '.join(header)}")
    place = list(header).index(name)
    if not unit:
        column, _ = _named(quantity, header, place)
        return replace(column, why="as given")
    if quantity == "time" and "%" in unit:
        return replace(Column(quantity, name, place=place), unit=unit, why="as given")
    bare = unit.lstrip("-")
    meant = known_unit(quantity, bare.lower())
    if meant is None:
        raise InputError(f"--column {text}: the unit is one of {_spellings(quantity)}")
    column = Column(quantity, name, place=place).measured_in(bare, meant, "as given")
    return column.turned() if unit.startswith("-") else column


def column_of(quantity: str, header: Sequence[str], place: int) -> Column:
    """A column with the unit of its name or app, if any; InputError for an unknown unit."""
    column, foreign = _named(quantity, header, place)
    if foreign and quantity != "time":
        raise InputError(
            f"column {column.name!r}: the unit [{foreign}] of {quantity} is not known; say "
            f"--column '{quantity}={column.name}:UNIT' with one of {_spellings(quantity)}"
        )
    return column


def _named(quantity: str, header: Sequence[str], place: int) -> tuple[Column, str]:
    """A column with the unit that its name or app implies, and an unknown unit, if any."""
    name, app = header[place], app_of(header)
    column = Column(quantity, name, place=place)
    text, unit = unit_of(quantity, name)
    if unit is not None:
        return column.measured_in(text, unit, "by its name"), ""
    by_app = app.units.get(name, "") if app else ""
    if app and (unit := known_unit(quantity, by_app)):
        marks = ", ".join(map(repr, app.marks))
        column = column.measured_in(by_app, unit, f"as in logs with a column {marks}")
        return column.guessed(app.could_be.get(name, ())), ""
    return column, text


def _spellings(quantity: str) -> str:
    return ", ".join(QUANTITIES[quantity].units)


def unused_columns(
    header: Sequence[str], used: Sequence[Column], clock: Collection[int], empty: Collection[int]
) -> dict[str, str]:
    """Why each other column is not used; `clock` and `empty` are column indices."""
    taken = {column.quantity: column for column in used}
    places = {*(column.place for column in used), *(column.back for column in used), *clock}
    return {
        name: EMPTY if place in empty else _reason(name, taken)
        for place, name in enumerate(header)
        if name and place not in places
    }


def _reason(name: str, taken: Mapping[str, Column]) -> str:
    for quantity, column in taken.items():
        if score(quantity, name) > 0.0:
            return f"{quantity} is read from {column.name!r}"
    for quantity in QUANTITIES.keys() - taken.keys() - NEEDED:
        if score(quantity, name) > 0.0 and (text := _foreign(quantity, name)):
            return f"the unit [{text}] of {quantity} is not known"
    if score("power", name) > 0.0 and {"voltage", "current"} <= taken.keys():
        return "power is voltage times current"
    if not {"soh", "health"}.isdisjoint(words_of(name)[0].split()):
        return HEALTH
    parts = (why for quantity, why in OF_PARTS.items() if speaks_of(quantity, name))
    return next(parts, NO_USE)


def by_reason(unused: Mapping[str, str]) -> dict[str, list[str]]:
    """Names of columns by the reason why they are not used."""
    names_by_reason: dict[str, list[str]] = {}
    for name, why in unused.items():
        names_by_reason.setdefault(why, []).append(name)
    return names_by_reason
