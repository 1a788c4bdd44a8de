"""Columns as signals: accelerations, interpolation, distances, and the mass from power."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

EVENT = 0.3  # m/s^2 from which on a car accelerates or brakes
LEAST_EVENTS = 20  # moments of accelerating, and of braking, needed to judge a sign
# s between two speeds that still give an acceleration: 10 s, by stamps that may be rounded to 4
# decimals of a minute or to 5 of an hour.
LONGEST_STEP = 10.05
EARTH = 6_371_000.0  # m
LEAST_WAY = 1e-9  # in any unit
HARDEST, LEAST_LEAP, LONGEST_LEAP = 4.0, 1.0, 3.0  # m/s^2, m/s, s
LIKE = 0.4  # least correlation of power with speed times acceleration that gives the mass

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Signal:
    """Samples of a column: times, s, and values in the file's unit, shape (n,) each."""

    time: FloatArray
    value: FloatArray

    def points(self) -> tuple[FloatArray, FloatArray]:
        """Times and values where both are finite."""
        finite = np.isfinite(self.time) & np.isfinite(self.value)
        return self.time[finite], self.value[finite]

    @property
    def known(self) -> FloatArray:
        """The finite values."""
        return self.value[np.isfinite(self.value)]


def last_known(values: FloatArray) -> FloatArray:
    """Each value held until the next finite one; NaN before the first."""
    last = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(values.size), 0))
    return np.asarray(values[last])


def pull(speed: Signal, power: Signal) -> float:
    """Power over speed times acceleration: for W and m/s, the mass, kg; NaN if uncorrelated."""
    times, change = accelerations(speed)
    kinetic = change * at_times(speed, times)
    drawn = at_times(power, times)
    both = np.isfinite(kinetic) & np.isfinite(drawn)
    if both.sum() < LEAST_EVENTS or not kinetic[both].any() or not np.ptp(drawn[both]):
        return np.nan
    spread = np.cov(kinetic[both], drawn[both])
    if abs(spread[0, 1]) < LIKE * np.sqrt(spread[0, 0] * spread[1, 1]):
        return np.nan
    return float(spread[0, 1] / spread[0, 0])


def battery_power(signals: Mapping[str, Signal]) -> Signal | None:
    """Voltage times current if both are there, else the power; None without either."""
    if {"voltage", "current"} <= signals.keys():
        current = signals["current"]
        return Signal(current.time, current.value * at_times(signals["voltage"], current.time))
    return signals.get("power")


def correlation(values: FloatArray, others: FloatArray, least: int = LEAST_EVENTS) -> float:
    """Correlation where both are finite; NaN for fewer than `least` values, or a constant."""
    both = np.isfinite(values) & np.isfinite(others)
    values, others = values[both], others[both]
    if values.size < least or not np.ptp(values) or not np.ptp(others):
        return np.nan
    return float(np.corrcoef(values, others)[0, 1])


def accelerations(speed: Signal) -> tuple[FloatArray, FloatArray]:
    """Midpoints, s, and slopes of speed over about a second, shape (n,) each."""
    time, value = speed.points()
    if time.size < 3:
        return np.empty(0), np.empty(0)
    steps = np.diff(time)
    typical = np.median(steps[steps > 0]) if (steps > 0).any() else 1.0
    stride = int(np.clip(round(1.0 / typical), 1, 1000)) if typical > 0 else 1
    span = time[stride:] - time[:-stride]
    near = (span > 0.2) & (span <= LONGEST_STEP)
    change = (value[stride:] - value[:-stride])[near] / span[near]
    return 0.5 * (time[stride:] + time[:-stride])[near], change


def leaps(time: FloatArray, speed: FloatArray) -> NDArray[np.bool_]:
    """Mask, shape (n - 1,), of the steps of a speed, m/s, that no car can make."""
    steps, change = np.diff(time), np.abs(np.diff(speed))
    return np.asarray((change > LEAST_LEAP + HARDEST * steps) & (steps <= LONGEST_LEAP))


def speeds_up_and_down(speed: Signal) -> bool:
    """True if a speed, m/s, changes often enough for the battery to show it."""
    return int((np.abs(accelerations(speed)[1]) > EVENT).sum()) >= LEAST_EVENTS


def at_times(signal: Signal, times: FloatArray) -> FloatArray:
    """The signal interpolated at n times, shape (n,); NaN outside it and within its gaps."""
    time, value = signal.points()
    if time.size < 2:
        return np.full(times.shape, np.nan)
    order = np.argsort(time, kind="stable")
    time, value = time[order], value[order]
    interpolated = np.interp(times, time, value)
    after = np.clip(np.searchsorted(time, times), 1, time.size - 1)
    inside = (times > time[after - 1]) & (times < time[after])
    far = inside & (time[after] - time[after - 1] > LONGEST_STEP)
    far |= (times < time[0]) | (times > time[-1])
    interpolated[far] = np.nan
    return interpolated


def ways(speed: Signal, times: FloatArray) -> FloatArray:
    """Distances between n times by the speed, shape (n - 1,); NaN across a gap and for 0."""
    at, value = speed.points()
    span = np.diff(at)
    middle = 0.5 * np.abs(value[1:] + value[:-1])
    way = np.concatenate(([0.0], np.cumsum(middle * span)))
    gaps = np.concatenate(([0.0], np.cumsum(span > LONGEST_STEP)))
    ways = np.diff(np.interp(times, at, way))
    return np.where((np.diff(np.interp(times, at, gaps)) == 0) & (ways > LEAST_WAY), ways, np.nan)


def steps_of_places(cells: Mapping[str, Signal], apart: float) -> tuple[FloatArray, FloatArray]:
    """Times, shape (n,), of positions over `apart` m from the last; distances, m, (n - 1,)."""
    time, *degrees = cells["latitude"].time, cells["latitude"].value, cells["longitude"].value
    north, east = np.radians(degrees)
    there = np.isfinite(north + east + time) & (north != 0.0)
    time, north, east = time[there], north[there], east[there]
    if time.size < 2:
        return time, np.empty(0)
    place = EARTH * np.column_stack((north, (east - east[0]) * np.cos(north)))
    picked = [0]
    for i in range(1, time.size):
        if np.hypot(*(place[i] - place[picked[-1]])) > apart:
            picked.append(i)
    return time[picked], np.hypot(*np.diff(place[picked], axis=0).T)
