"""Units, signs and repeated cells, inferred from the values of columns.

A logger that fills cells with the last known value makes a staircase of speed, as in the Vehicle
Energy Dataset. If rows are uneven, a fine signal that repeats a value was not measured again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
import math

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.logs.column import SIGNED, Column, column_of
from evpinn_ros.logs.quantities import QUANTITIES, Unit, score
from evpinn_ros.logs.rows_to_blocks import LOADS
from evpinn_ros.logs.signal import (
    EVENT,
    LEAST_EVENTS,
    LONGEST_STEP,
    FloatArray,
    Signal,
    accelerations,
    at_times,
    correlation,
    last_known,
    pull,
)
from evpinn_ros.logs.speed_unit import with_speed_unit

CRUISING = 5.0  # m/s: above it the mean battery power is positive
LEAST_CRUISE = 30  # readings of such a mean
SAG = 0.3  # correlation of current and voltage from which on resistance is visible
LEAST_SAGS = 30  # steps of both
STRONG = 150.0  # kW: seldom exceeded; as many W move a light vehicle
WEAKEST = 1000.0  # W: a car that never takes more does not drive
HIGHEST, HEAVIEST = 2000.0, 5000.0  # V, A: above any vehicle's battery
HOTTEST = 38.0  # degrees C: no drive has a higher median, so it is F
BACKWARDS = 0.99  # share of the nonzero speeds
SELDOM, OVERLAP = 0.02, 0.1  # values of the other sign; smaller over larger of two flows
KELVIN = 200.0  # larger medians are in K
STEEPEST, STEEPEST_MEAN = 0.4, 0.12  # fractions, of roads and trips: larger values are percent
ALIKE = 0.5  # correlation from which on two powers are the same, up to sign and size
RESOLUTIONS = (1.0, 0.5, 0.25, 0.1, 0.05, 0.025, 0.02, 0.01, 0.001)  # of signals on a bus
SPANS = sorted(step * 2.0**bits for step in RESOLUTIONS for bits in (16, 32))
FEW_BITS = sorted(step * 2.0**bits for step in RESOLUTIONS for bits in range(8, 16))
LEAST_WRAPPED = 5  # readings
NOT_TRACTION = 40.0  # V: below, a battery that does not sag under current is another one
GEARED = 0.98  # correlation of speed and motor speed
MAY_BE_HELD = ("speed", "current", "power")
UNEVEN = 0.5  # share of the usual step: one step in twenty is shorter
LEAST_REPEATS = 0.1  # share of the steps
FINE = 10.0  # resolutions by which a signal usually changes
LEAST_ROWS = 100


def with_units(columns: Mapping[str, Column], cells: Mapping[str, Signal]) -> dict[str, Column]:
    """The columns, each with a unit and a sign."""
    decided = dict(columns)
    for name, decide in _BY_VALUES.items():  # the unit of speed needs those of the others
        if name in decided and (not decided[name].has_unit or decided[name].could_be):
            decided[name] = decide(decided[name], cells[name].known)
    for name in SIGNED:
        if name in decided and (
            span := wrapped(cells[name].known)
            or wrapped_while_braking(cells[name], cells["speed"])
        ):
            decided[name] = replace(decided[name], wraps=span)
            cells = {**cells, name: Column(name, "", wraps=span).in_si(cells[name])}
    decided = with_speed_unit(decided, cells)
    for name in SIGNED:
        if name in decided and decided[name].why != "as given" and not decided[name].is_ours:
            decided[name] = _with_sign(decided[name], cells[name], decided["speed"], cells)
    for name, column in decided.items():
        if not column.has_unit:
            units = iter(QUANTITIES[name].units)
            column = column.in_unit(next(units), "")
            decided[name] = column.guessed(("ft",)) if name == "elevation" else column
    return decided


def is_backwards(speed: Signal) -> bool:
    """True if a car seems to always drive backwards: its sensor counts that way."""
    moving = speed.known[speed.known != 0.0]
    return moving.size >= LEAST_EVENTS and bool(np.mean(moving < 0.0) > BACKWARDS)


def flows_one_way(drawn: FloatArray, back: FloatArray) -> bool:
    """True if two columns are drawn and returned flow: of one sign, and seldom both at once."""
    for values in (drawn, back):
        if min(np.sum(values < 0.0), np.sum(values > 0.0)) > SELDOM * np.isfinite(values).sum():
            return False
    sizes = np.abs(np.nan_to_num([last_known(drawn), last_known(back)]))
    enough = min(np.isfinite(drawn).sum(), np.isfinite(back).sum()) >= LEAST_EVENTS
    return bool(enough and sizes.min(axis=0).sum() <= OVERLAP * sizes.max(axis=0).sum())


def net(drawn: FloatArray, back: FloatArray) -> FloatArray:
    """Drawn minus returned flow, shape (n,), where either is known; the other keeps its last."""
    flow = np.abs(np.nan_to_num(last_known(drawn))) - np.abs(np.nan_to_num(last_known(back)))
    return np.where(np.isfinite(drawn) | np.isfinite(back), flow, np.nan)


def is_engine(turning: Signal, speed: Signal) -> bool:
    """True if a motor's speed is that of a combustion engine: it does not follow the car's."""
    turns = at_times(turning, speed.time)
    return bool((turns > 0).any()) and correlation(speed.value, turns) < GEARED


def of_12_volts(columns: Mapping[str, Column], cells: Mapping[str, Signal]) -> str:
    """Why a voltage is not that of the traction battery; empty if it may be."""
    if not {"voltage", "current"} <= columns.keys() or columns["voltage"].why == "as given":
        return ""
    volts = cells["voltage"].known * columns["voltage"].factor
    middle = float(np.median(volts)) if volts.size >= LEAST_EVENTS else np.nan
    amperes = cells["current"].known
    if not 0 < middle < NOT_TRACTION or not amperes.size or not np.ptp(amperes):
        return ""
    volts = at_times(cells["voltage"], cells["current"].time)
    both = np.isfinite(volts) & np.isfinite(cells["current"].value)
    if both.sum() < LEAST_SAGS or not np.ptp(volts[both]):
        return ""
    ranks = [
        values[both].argsort().argsort().astype(np.float64)
        for values in (volts, cells["current"].value)
    ]
    alike = correlation(ranks[0], ranks[1])  # robust against glitches
    if abs(alike) > ALIKE or _sag(cells["current"], cells["voltage"]) != 0.0:
        return ""
    return f"about {_figures(middle)} V whatever the current, not that of the traction battery"


def _with_sign(
    column: Column, drawn: Signal, speed: Column, cells: Mapping[str, Signal]
) -> Column:
    """The column, positive at discharge; assumed if evidence is missing or contradictory."""
    sag = _sag(drawn, cells["voltage"]) if "voltage" in cells else 0.0
    mass = pull(speed.in_si(cells["speed"]), drawn)
    if sag and mass * sag > 0.0:  # a computed voltage does not drop under load
        positive, shows, certain = mass > 0.0, "as accelerating shows, not the voltage", False
    elif sag:
        positive, shows, certain = sag < 0.0, "as the voltage shows", True
    else:
        positive, shows, certain = _sign_of_driving(drawn, speed, cells)
    why = f"{'positive' if positive else 'negative'} while it discharges, {shows}"
    column = replace(column if positive else column.turned(), why=why)
    return column if certain else column.guessed((column.turned_unit,))


def _sign_of_driving(
    drawn: Signal, speed: Column, cells: Mapping[str, Signal]
) -> tuple[bool, str, bool]:
    """True if positive at discharge, the evidence for people, and True if that is certain."""
    times, change = accelerations(cells["speed"])
    at, change = at_times(drawn, times), change * speed.factor
    taken = at[(change > EVENT) & np.isfinite(at)]
    given = at[(change < -EVENT) & np.isfinite(at)]
    if min(taken.size, given.size) >= LEAST_EVENTS:
        return bool(taken.mean() > given.mean()), "as accelerating shows", True
    fast = at_times(cells["speed"], drawn.time) * speed.factor > CRUISING
    cruise = drawn.value[fast & np.isfinite(drawn.value)]
    if cruise.size < LEAST_CRUISE or cruise.mean() == 0:
        return True, "assumed", False
    return bool(cruise.mean() > 0), "as driving shows", True


def _sag(current: Signal, voltage: Signal) -> float:
    """Correlation of steps of current and voltage, which drops under load; 0 if unclear."""
    at = at_times(voltage, current.time)
    both = np.isfinite(at) & np.isfinite(current.value)
    amps, volts = np.diff(current.value[both]), np.diff(at[both])
    near = np.diff(current.time[both]) <= LONGEST_STEP
    alike = correlation(amps[near], volts[near], LEAST_SAGS)
    return alike if abs(alike) > SAG else 0.0


def wrapped_while_braking(drawn: Signal, speed: Signal) -> float:
    """Span of unsigned numbers of few bits, whose upper values occur at braking; or 0.

    They pass zero by steps of nearly the span, more often than they change by half of it.
    """
    numbers = drawn.known
    span = _span(numbers, FEW_BITS)
    steps = np.abs(np.diff(numbers))
    across = int(np.sum(steps > 0.75 * span))
    if across < max(LEAST_WRAPPED, int(np.sum(steps > 0.5 * span)) - across):
        return 0.0
    times, change = accelerations(speed)
    at = at_times(Signal(drawn.time, (drawn.value > 0.5 * span).astype(float)), times)
    upper, lower = change[at > 0.5], change[at <= 0.5]
    if min(upper.size, lower.size) < LEAST_WRAPPED:
        return 0.0
    return span if np.mean(upper) < min(0.0, float(np.mean(lower))) else 0.0


def wrapped(numbers: FloatArray) -> float:
    """Span of unsigned numbers that wrap below zero (-13.6 A is 65536 steps more), else 0."""
    span = _span(numbers, SPANS)
    middle = (numbers > 0.25 * span) & (numbers < 0.75 * span)
    upper = numbers >= 0.75 * span
    return span if upper.sum() >= LEAST_WRAPPED and not middle.any() else 0.0


def _span(numbers: FloatArray, spans: Sequence[float]) -> float:
    """The shortest span that holds all numbers; infinite without one, or below zero."""
    if not numbers.size or numbers.min() < 0:
        return math.inf
    return next((span for span in spans if numbers.max() <= span), math.inf)


def _voltage_unit(column: Column, values: FloatArray) -> Column:
    middle = float(np.median(values)) if values.size else 0.0
    text = "mv" if middle > HIGHEST else "v"
    return column.in_unit(text, f"by its values, about {_figures(middle)}")


def _current_unit(column: Column, values: FloatArray) -> Column:
    largest = _largest(values)
    text = "ma" if largest > HEAVIEST else "a"
    return column.in_unit(text, f"by its values, up to {_figures(largest)}")


def _power_unit(column: Column, values: FloatArray) -> Column:
    largest = _largest(values)
    text = "kw" if 0 < largest < WEAKEST else "w"
    column = column.in_unit(text, f"by its values, up to {_figures(largest)}")
    return column.guessed(("w",)) if STRONG < largest < WEAKEST else column


def _figures(number: float) -> str:
    """Three figures, without an exponent below a million."""
    return f"{float(f'{number:.3g}'):g}"


def _largest(values: FloatArray) -> float:
    return float(np.quantile(np.abs(values), 0.99)) if values.size else 0.0


def _charge_unit(column: Column, values: FloatArray) -> Column:
    highest = float(values.max(initial=0.0))
    if 0 < highest <= 1.0:
        return column.in_unit("fraction", "by its values")
    if values.size and np.median(values) > 100.0:
        # LeafSpy counts 1/10000 of a percent.
        factor = 10.0 ** -np.ceil(np.log10(highest / 101.0))
        return column.measured_in(f"{factor:g} %", Unit(float(factor)), "by its values")
    return column.in_unit("%", "by its values")


def _temperature_unit(column: Column, values: FloatArray) -> Column:
    middle = float(np.median(values)) if values.size else 0.0
    if middle > KELVIN:
        return column.in_unit("k", f"its median of {middle:.3g} is too hot for °C and °F").guessed(
            ()
        )
    if middle > HOTTEST:
        return column.in_unit("f", f"its median of {middle:.3g} is too hot for °C").guessed(())
    if column.could_be:  # depending on a setting of the app
        return column
    return column.in_unit("c", f"as its median is {middle:.3g}").guessed(("f",))


def in_fractions(grades: FloatArray) -> bool:
    """True if grades are fractions, not percent, by the steepest roads and trips."""
    size = np.abs(grades)
    return bool(size.max(initial=0.0) <= STEEPEST and size.sum() <= STEEPEST_MEAN * size.size)


def _grade_unit(column: Column, values: FloatArray) -> Column:
    texts = ("fraction", "percent", "deg")
    text, *others = texts if in_fractions(values) else texts[1:]
    return column.in_unit(text, "by its values").guessed(others)


_BY_VALUES = {
    "grade": _grade_unit,
    "voltage": _voltage_unit,
    "current": _current_unit,
    "power": _power_unit,
    "charge": _charge_unit,
    "ambient": _temperature_unit,
}
"""Rules that infer the unit of a quantity from its values."""


def held_columns(signals: Mapping[str, Signal]) -> frozenset[str]:
    """Quantities whose cells repeat the last value where nothing was measured."""
    return frozenset(name for name in MAY_BE_HELD if name in signals and _is_held(signals[name]))


def _is_held(signal: Signal) -> bool:
    time, value = signal.points()
    steps = np.diff(time)
    if len(steps) < LEAST_ROWS or np.quantile(steps, 0.05) > UNEVEN * np.median(steps):
        return False
    changes = np.abs(np.diff(value))
    changed = changes[changes > 0.0]
    if not changed.size or np.mean((changes == 0.0) & (value[1:] != 0.0)) < LEAST_REPEATS:
        return False
    resolution = np.quantile(np.diff(np.unique(value)), 0.05)
    return bool(np.median(changed) > FINE * resolution)


def power_beside(header: Sequence[str], used: Sequence[Column]) -> Column | None:
    """A column of battery power that is unnecessary besides voltage and current."""
    taken = {column.quantity: column.place for column in used}
    if not {"voltage", "current"} <= taken.keys() or "power" in taken:
        return None
    free = (place for place in range(len(header)) if place not in taken.values())
    scores = {
        place: score("power", header[place])
        for place in free
        if not any(score(load, header[place]) > 0.0 for load in LOADS)
    }
    place = max(scores, key=lambda i: scores[i], default=0)
    with suppress(InputError):  # an unknown unit is no evidence
        return column_of("power", header, place) if scores.get(place, 0.0) > 0.0 else None
    return None
