"""Tables of plans: speed over time under our names, and legs with their units in the header."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain, islice
import math
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias
import warnings

import numpy as np

from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.core.energy.plan import (
    LEAST_LENGTH,
    MAX_POINTS,
    UNITS_APART,
    Legs,
    Plan,
    PlanError,
    legs_of,
    legs_of_trip,
    plan_from_speed_profile,
    refuse,
    sums,
)
from evpinn_ros.logs.numbers import COMMA, POINT, Style, is_missing, style_of, to_floats
from evpinn_ros.logs.plans.way import possible_heights
from evpinn_ros.logs.quantities import ANGLES, score, unit_of, words_of
from evpinn_ros.logs.survey import data_rows, find_head
from evpinn_ros.logs.table_drive import LEVEL
from evpinn_ros.logs.text_table import TextTable
from evpinn_ros.logs.values import in_fractions

COLUMNS = "columns t_s and speed_mps, or those of legs, length_m and duration_s or speed_kmh"
FEW = 8  # names listed in an error
LEAST_RISING = 7  # legs, whose lengths rise by chance once in 5040 plans
SAID_RISING = 4  # legs, once in 24
LEAST_SUMMED = 3  # rows of which the last may be a total
STEEPEST = 0.5  # of any road: 35 % in a street, more on a track
NEEDED = ("t_s", "speed_mps")
BATTERY = ({"voltage_v", "current_a"}, {"power_w"})  # of a drive; a forecast also has a distance
Kinds: TypeAlias = Mapping[str, tuple[tuple[str, ...], str]]
"""Columns by their kind: words before the unit, and a quantity of the same units."""
PROFILE_COLUMNS: Kinds = {  # "cyc" as FASTSim has it: cycSecs, cycMps, cycGrade
    "time": (("t", "time", "cyc"), "time"),
    "speed": (("speed", "cyc", ""), "speed"),
    "distance": (("distance", "length"), "odometer"),
    "elevation": (("elevation", "height", "altitude"), "elevation"),
}
LEG_COLUMNS: Kinds = {
    "length": (("length", "distance"), "odometer"),
    "duration": (("duration", "travel time"), "time"),
    "speed": (("speed", "mean speed"), "speed"),
    "climb": (("climb", "rise"), "elevation"),
    "start": (("start elevation", "start height"), "elevation"),
    "end": (("end elevation", "end height", "elevation", "height"), "elevation"),
}
HEIGHTS = {"elevation", "climb", "end"}  # columns that make a slope unnecessary
SLOPES = {"grade", "incline"}
CYCLE = (
    "times, speeds and slopes are read as a driving cycle, driven exactly; --expected adds what "
    "drivers do between its points"
)


def plan_of_columns(given: Mapping[str, Any]) -> Plan | Legs:
    """The plan of columns `t_s` and `speed_mps`, or of legs; warns of unused columns.

    InputError: columns are missing, or contain values that are no numbers; `PlanError`: no trip.
    """
    names = [*map(str, given)]
    if columns := profile_columns(names):
        warn_of_unused(names, (name for name, _ in columns.values()))
        profile = {
            kind: column
            for kind, column in _in_si(columns, given).items()
            if kind in ("time", "speed") or not np.isnan(column).all()  # an empty one says nothing
        }
        time, speed, distance = profile["time"], profile["speed"], profile.get("distance")
        plan = plan_from_speed_profile(time, distance, speed, profile.get("elevation"))
        if "grade" in profile:
            length = np.diff(plan.distance)
            grade = (profile["grade"][1:] + profile["grade"][:-1]) / 2.0
            warnings.warn(CYCLE, stacklevel=3)
            plan = replace(plan, elevation=sums(_climb(length, grade)), commanded=True, level=True)
        return plan
    if columns := leg_columns(names):
        warn_of_unused(names, (name for name, _ in columns.values()))
        legs = _in_si(columns, given)
        _check_each(legs)
        if "end" in legs and "start" not in legs:
            legs["start"] = np.concatenate(([np.nan], legs["end"][:-1]))
        return legs_of_trip(*_leg_numbers(legs))
    there = ", ".join(names[:FEW]) or "none"
    raise InputError(f"a plan has the {COLUMNS}; there are: {there}")


def _check_each(legs: Mapping[str, np.ndarray]) -> None:
    """Refuse, or warn of, columns that seem counted from the start, or that end with a total."""
    for kind in ("length", "duration"):
        column = legs.get(kind, np.empty(0))
        if len(column) >= SAID_RISING and (np.diff(column) > 0.0).all():
            text = (
                f"each {kind} is larger than the one before, as if counted from the start; give "
                "that of each leg"
            )
            if len(column) >= LEAST_RISING:
                raise PlanError(text)
            warnings.warn(text, stacklevel=4)
    columns = [legs[kind] for kind in ("length", "duration") if kind in legs]
    if len(columns[0]) >= LEAST_SUMMED and all(
        math.isclose(column[-1], column[:-1].sum(), rel_tol=1e-3) for column in columns
    ):
        text = "the last leg is as long as all before it together: if it is a total, leave it out"
        warnings.warn(text, stacklevel=4)


def edges_of_columns(given: Mapping[str, Any]) -> Legs:
    """Edges of a road network from columns of legs, in any order. InputError, PlanError."""
    columns = leg_columns([*given])
    if not columns:
        raise InputError("edges have two of the columns length_m, duration_s and speed_kmh")
    return legs_of(*_leg_numbers(_in_si(columns, given)))


def table_plan(path: Path) -> Plan | Legs | None:
    """The plan in a text table; None if its columns are no plan's, but perhaps a drive's."""
    table = TextTable(path)
    head = find_head(table)
    names = {*head.names}
    recorded = "distance_m" not in names and any(columns <= names for columns in BATTERY)
    columns = {} if recorded else profile_columns(head.names)
    if not {*NEEDED} <= names and (not SLOPES & columns.keys() or _has_battery(head.names)):
        columns = {} if recorded else leg_columns(head.names)
    if not columns:
        return None
    used = {name for name, _ in columns.values()}
    warn_of_unused(head.names, used)
    places = {name: place for place, name in enumerate(head.names) if name in used}
    cells: dict[str, list[str]] = {name: [] for name in places}  # there may be thousands of others
    for _, row in islice(data_rows(table, head), MAX_POINTS + 1):
        for name, place in places.items():
            cells[name].append(row[place] if place < len(row) else "")
    usual = COMMA if table.separator == ";" else POINT  # 1,250 alone may be either
    style = style_of(list(chain(*cells.values()))) or usual
    return plan_of_columns({name: Cells(texts, style) for name, texts in cells.items()})


def _has_battery(names: Sequence[str]) -> bool:
    """True for columns of a recorded drive, whose reader supports no grade."""
    return any(score(kind, name) > 0 for kind in ("voltage", "current", "power") for name in names)


def warn_of_unused(names: Iterable[str], used: Iterable[str] = ()) -> None:
    """Warn of names of columns that a plan does not use, if any."""
    used = {*used}
    if unused := [name for name in names if name.strip() and name not in used]:
        more = f" and {len(unused) - FEW} more" if len(unused) > FEW else ""
        text = f"columns of the plan that are not used: {', '.join(unused[:FEW])}{more}"
        warnings.warn(text, stacklevel=3)


class Cells(NamedTuple):
    """Text cells of a column, and their number style."""

    cells: list[str]
    style: Style


def profile_columns(names: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Name and SI value per unit of the columns of speed over time by kind; else empty."""
    columns, _ = _known_columns(names, PROFILE_COLUMNS)
    return columns if columns.keys() >= {"time", "speed"} else {}


def leg_columns(names: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Name and SI value per unit of the columns of legs by kind; PlanError without unit."""
    columns, bare = _known_columns(names, LEG_COLUMNS)
    ours = {name for name, _ in columns.values()} | {*bare.values()}
    timed = any(score("time", str(name)) > 0 for name in names if name not in ours)
    if timed or len((columns.keys() | bare.keys()) & {"length", "duration", "speed"}) < 2:
        return {}
    if bare:
        raise PlanError(
            f"the column {[*bare.values()][-1]!r} does not say its unit, as length_km and "
            "speed_kmh do"
        )
    return columns


def _known_columns(
    names: Sequence[str], kinds: Kinds
) -> tuple[dict[str, tuple[str, float]], dict[str, str]]:
    """Columns with SI value per unit (NaN: a grade without unit), and those that state no unit.

    A grade given as an angle has the name incline.
    """
    columns: dict[str, tuple[str, float]] = {}
    bare: dict[str, str] = {}
    for name in map(str, names):
        if score("grade", name) > 0.0 and not columns.keys() & SLOPES:
            text, unit = unit_of("grade", name)
            kind = "incline" if text in ANGLES else "grade"
            columns[kind] = name, unit.factor if unit else math.nan
            continue
        for kind, (phrases, quantity) in kinds.items():
            text, unit = unit_of(quantity, name)
            words = words_of(name)[0].replace(" per ", " ").strip()
            if unit is None and words in phrases:
                bare[kind] = name
            elif unit and words.removesuffix(text.replace("/", " ")).strip() in phrases:
                columns[kind] = name, unit.factor
    if columns.keys() & HEIGHTS:
        columns = {kind: column for kind, column in columns.items() if kind not in SLOPES}
    return columns, bare


def _in_si(
    columns: Mapping[str, tuple[str, float]], given: Mapping[str, Any]
) -> dict[str, np.ndarray]:
    numbers = {
        kind: _numbers(name, given[name]) * (1.0 if math.isnan(factor) else factor)
        for kind, (name, factor) in columns.items()
    }
    if "grade" in columns and math.isnan(columns["grade"][1]):
        numbers["grade"] *= _grade_unit(columns["grade"][0], numbers["grade"])
    if "incline" in numbers:
        numbers["grade"] = np.tan(numbers.pop("incline"))
    refuse(np.abs(numbers.get("grade", np.empty(0))) > STEEPEST, "no road is so steep", "row")
    for kind in numbers.keys() & {"elevation", "start", "end"}:
        here = numbers[kind]
        refuse(~np.isnan(here) & ~possible_heights(here), "no road is at this height", "row")
    heights = numbers.get("elevation", numbers.get("end", np.empty(0)))
    if len(heights) > 1 and np.ptp(heights) == 0.0:
        warnings.warn(LEVEL, stacklevel=4)
    if len({len(column) for column in numbers.values()}) > 1:
        lengths = ", ".join(f"{name} {len(numbers[kind])}" for kind, (name, _) in columns.items())
        raise InputError(f"the columns have different numbers of rows: {lengths}")
    return numbers


def _leg_numbers(
    given: Mapping[str, np.ndarray],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Length, duration and climb, shape (n,) each; missing cells follow from the others."""
    unknown = np.full(len(next(iter(given.values()))), np.nan)
    length, duration, speed, climb = (
        given.get(name, unknown) for name in ("length", "duration", "speed", "climb")
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        duration = np.where(np.isnan(duration), length / speed, duration)
        length = np.where(np.isnan(length), speed * duration, length)
        apart = np.abs(np.log(length / (speed * duration))) > math.log(UNITS_APART)
    apart &= length > LEAST_LENGTH
    refuse(apart, "length, duration and speed contradict each other", "leg")
    untimed = np.isnan(given.get("duration", unknown)) & (length > 0)
    refuse(untimed & (speed == 0), "speed is 0", "leg")
    refuse(untimed & (speed < 0), "speed is negative", "leg")
    if "end" in given and "start" in given:
        climb = np.where(np.isnan(climb), given["end"] - given["start"], climb)
    if "grade" in given:
        climb = _climb(length, given["grade"])
    return length, duration, climb


def _grade_unit(name: str, grade: np.ndarray) -> float:
    """1 for fractions, 0.01 for percent, by the steepest roads and trips; warns of the choice."""
    grade = grade[np.isfinite(grade)]
    if not grade.any():
        return 1.0
    fractions = in_fractions(grade)
    assumed, other = ("fractions", "percent") if fractions else ("percent", "fractions")
    text = f"{name!r} is assumed to be in {assumed}; if it is in {other}, name the column"
    warnings.warn(f"{text} {'grade_percent' if fractions else 'grade_fraction'}", stacklevel=5)
    return 1.0 if fractions else 0.01


def _climb(length: np.ndarray, grade: np.ndarray) -> np.ndarray:
    """Climbs over lengths along the road; `grade` is relative to the horizontal."""
    return np.asarray(length * grade / np.hypot(1.0, grade))


def _numbers(name: str, values: Any) -> np.ndarray:
    if isinstance(values, Cells):
        numbers = to_floats(*values)
        for place in np.flatnonzero(np.isnan(numbers)):
            if not is_missing(cell := values.cells[place][:40]):
                raise InputError(f"{name}: {cell!r} in row {place + 1} is not a number")
        return numbers
    with as_input_error(f"{name} holds no numbers", TypeError, ValueError, OverflowError):
        array = np.atleast_1d(np.asarray(values))
        if array.dtype.kind in "mM":
            raise InputError(f"{name} holds dates; give seconds, as dt.total_seconds() does")
        numbers = np.array(array.tolist(), float)
    if numbers.ndim > 1:
        raise InputError(f"{name} has the shape {numbers.shape}; a plan is one trip")
    return numbers
