"""Infers the unit of a speed and of an odometer whose names have none.

Positions and an odometer of known unit show it; with an unknown odometer, km/h with km fits as
well as mph with miles. The power of accelerating gives the mass, of known order of magnitude. If
several units fit, one is assumed and reported as such.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from evpinn_ros.logs.column import Column
from evpinn_ros.logs.quantities import PLACES, QUANTITIES
from evpinn_ros.logs.signal import (
    LEAST_EVENTS,
    Signal,
    accelerations,
    battery_power,
    pull,
    steps_of_places,
    ways,
)

FASTEST = {
    "m/s": 45.0,
    "mph": 130.0,
    "km/h": 250.0,
}  # largest plausible speed of a car in this unit
STRONGEST = 4.0  # m/s^2: a unit in which 1 % of the changes within a second exceed it is wrong
SAME_ROAD = 0.15  # log ratio of equal distances; m/s with miles is 0.33 from mph with km
LEAST_SEGMENTS, MOST_SEGMENTS = 3, 20  # from one step of the odometer to a later one
SEGMENT = 300.0  # m between two positions that give a distance
SPEEDS = {text: QUANTITIES["speed"].units[text].factor for text in ("km/h", "mph", "m/s")}
LENGTHS = {text: QUANTITIES["odometer"].units[text].factor for text in ("km", "mi")}


class Masses(NamedTuple):
    """Masses of a class of vehicles, kg; values outside the limits are impossible."""

    least: float
    usual: float
    heavy: float  # below it, km/h is likelier than a lighter vehicle in mph
    most: float


LIGHT, MIDDLE = Masses(20, 250, 1300, 8000), Masses(50, 700, 2000, 12_000)
CAR = Masses(150, 2000, 3200, 60_000)
LIGHT_BELOW, CAR_FROM = 60.0, 150.0  # V of the battery


def with_speed_unit(
    columns: Mapping[str, Column], cells: Mapping[str, Signal]
) -> dict[str, Column]:
    """The columns, with units of speed and odometer."""
    decided = dict(columns)
    speed, odometer = decided["speed"], decided.get("odometer")
    if not speed.has_unit:
        decided["speed"] = speed = _decided(speed, decided, cells)
    if odometer is not None and not odometer.has_unit:
        decided["odometer"] = _odometer(odometer, speed, cells)
    return decided


def _decided(speed: Column, columns: Mapping[str, Column], cells: Mapping[str, Signal]) -> Column:
    signal, odometer = cells["speed"], columns.get("odometer")
    if (text := _nearest(road_of_places(cells), SPEEDS)) is not None:
        return speed.in_unit(text, "by the positions")
    road = road_of_odometer(cells)
    if odometer is not None and odometer.has_unit:
        if (text := _nearest(road * odometer.factor, SPEEDS)) is not None:
            return speed.in_unit(text, "by the odometer")
        if odometer.why == "by its name":
            text = "mph" if odometer.unit.startswith("mi") else "km/h"
            others = [other for other in SPEEDS if other != text]
            return speed.in_unit(text, "as the odometer").guessed(others)
    possible = {
        text
        for text, factor in SPEEDS.items()
        if not road > 0
        or any(abs(np.log(road * length / factor)) < SAME_ROAD for length in LENGTHS.values())
    } or set(SPEEDS)
    possible = (possible - _too_fast(signal)) or set(SPEEDS)  # if impossible in each, any unit
    if len(possible) == 1:
        why = "by the odometer" if road > 0 else "by its values"
        return speed.in_unit(possible.pop(), why)
    text, why, left = _by_mass(possible, columns, cells) or _usual(possible, signal)
    column = speed.in_unit(text, why)
    return column if left == {text} else column.guessed(tuple(sorted(left - {text})))


def _too_fast(signal: Signal) -> set[str]:
    fastest = float(np.quantile(np.abs(signal.known), 0.999)) if signal.known.size else 0.0
    changes = np.sort(np.abs(accelerations(signal)[1]))
    hardest = changes[int(0.99 * changes.size)] if changes.size else 0.0
    return {
        text
        for text, factor in SPEEDS.items()
        if fastest > FASTEST[text] or hardest * factor > STRONGEST
    }


def _by_mass(
    possible: set[str], columns: Mapping[str, Column], cells: Mapping[str, Signal]
) -> tuple[str, str, set[str]] | None:
    """Unit with the likeliest mass, the reason, and all units with a possible mass."""
    of_battery = columns.keys() & {"voltage", "current", "power"}
    signals = {name: columns[name].in_si(cells[name]) for name in of_battery}
    power = battery_power(signals)
    mass = abs(pull(cells["speed"], power)) if power is not None else np.nan
    if not mass > 0:
        return None
    usual = _class_of(signals.get("voltage"))
    masses = {text: mass / SPEEDS[text] ** 2 for text in possible}
    left = {text for text, value in masses.items() if usual.least <= value <= usual.most}
    if not left:
        return None
    text = min(sorted(left), key=lambda unit: abs(np.log(masses[unit] / usual.usual)))
    if "km/h" in left and masses["km/h"] <= usual.heavy:
        text = "km/h"
    return text, "by the power that accelerating takes", left


def _class_of(voltage: Signal | None) -> Masses:
    """The class of vehicles with such a battery."""
    if voltage is None or not voltage.known.size:
        return CAR
    middle = float(np.median(voltage.known))
    return LIGHT if middle < LIGHT_BELOW else MIDDLE if middle < CAR_FROM else CAR


def _usual(possible: set[str], signal: Signal) -> tuple[str, str, set[str]]:
    value = signal.known
    fastest = float(np.abs(value).max(initial=0.0))
    if "m/s" not in possible or fastest > FASTEST["m/s"]:
        return "km/h", "by its values", possible
    if fastest > 1 and value.size > LEAST_EVENTS and not (value % 1).any():
        return "km/h", "by its whole numbers", possible
    return "m/s", f"by its values, up to {fastest:.3g}", possible


def _odometer(odometer: Column, speed: Column, cells: Mapping[str, Signal]) -> Column:
    """The odometer in the unit in which its distance agrees with the speed."""
    road = road_of_odometer(cells)
    text = _nearest(speed.factor / road if road > 0 else np.nan, LENGTHS)
    if text is None:
        return odometer.in_unit("km", "").guessed(("mi",))
    column = odometer.in_unit(text, "as the speed")
    return column.guessed(("km" if text == "mi" else "mi",)) if speed.could_be else column


def _nearest(road: float, factors: Mapping[str, float]) -> str | None:
    """Unit with approximately this factor; None without one."""
    if not road > 0:
        return None
    text = min(factors, key=lambda unit: abs(np.log(factors[unit] / road)))
    return text if abs(np.log(factors[text] / road)) < SAME_ROAD else None


def road_of_odometer(cells: Mapping[str, Signal]) -> float:
    """Distance of the odometer over that of the speed; NaN if unknown.

    A low quantile, as a speed by GPS may be lost.
    """
    if "odometer" not in cells:
        return np.nan
    time, value = cells["odometer"].points()
    time, value = time[value > 0], value[value > 0]
    steps = np.flatnonzero(np.diff(value) > 0) + 1
    if steps.size <= LEAST_SEGMENTS or cells["speed"].points()[0].size < LEAST_EVENTS:
        return np.nan
    steps = steps[:: max(1, steps.size // MOST_SEGMENTS)]
    ratios = np.diff(value[steps]) / ways(cells["speed"], time[steps])
    ratios = ratios[np.isfinite(ratios)]
    return float(np.quantile(ratios, 0.25)) if ratios.size >= LEAST_SEGMENTS else np.nan


def road_of_places(cells: Mapping[str, Signal]) -> float:
    """Distance between positions, m, over that of the speed; NaN if unknown.

    A high quantile, as roads bend.
    """
    if not cells.keys() >= set(PLACES) or cells["speed"].points()[0].size < LEAST_EVENTS:
        return np.nan
    times, far = steps_of_places(cells, SEGMENT)
    ratios = far / ways(cells["speed"], times)
    ratios = ratios[np.isfinite(ratios)]
    return float(np.quantile(ratios, 0.75)) if ratios.size >= LEAST_SEGMENTS else np.nan
