"""Power of battery and motor over the latest seconds, at a moment and as energy of an interval.

A polled car gives voltage and current at different times, a phone log every few seconds. Neither
is paired with the other by row: each is linear between its own readings, and their product is the
power. How far apart two readings may be to be joined follows the rate at which they come.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.core.signals.block import FIELDS, Rows
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, drawn_power
from evpinn_ros.core.signals.track import BEFORE, LATER, NEVER, SignalTrack

BRIDGE_SHARE = 1.0 / 12.0  # variance of the integral of a Brownian bridge, per step^2 and rise^2
TIMING = 0.2  # of a signal's usual step, 1-sigma by which its stamps are off
NOMINAL_RATIO = 27.0  # rad/m: a gear of 9 and tyres that roll on 0.33 m


class Energy(NamedTuple):
    """Energy of an interval, NaN where it is not measured.

    Attributes:
        energy: J.
        variance: due to sampling alone, J^2.
        returned: the part of it that went back into the battery, positive J.
    """

    energy: float
    variance: float
    returned: float


UNMEASURED = Energy(math.nan, math.nan, math.nan)


class BatteryTrack:
    """Voltage and current of the latest seconds."""

    def __init__(self, max_gap: float) -> None:
        """Never interpolate across gaps (see `SignalTrack`)."""
        self.voltage, self.current = self.tracks = SignalTrack(max_gap), SignalTrack(max_gap)
        # W, of a coarse reading, and the place of each
        self._orders, self._power_std = np.array([BEFORE]), np.zeros(1)

    def newest_ns(self, by: Any = LATER) -> Any:
        """Latest stamp up to which both were known, by places; `NEVER` before."""
        newest = []
        for track in self.tracks:
            stamps = np.concatenate(([NEVER], track.stamps))
            newest.append(stamps[track.count(by)])
        return np.minimum(*newest)

    def period(self, by: Any = LATER) -> Any:
        """Usual step between readings of the slower of the two, s."""
        return np.maximum(*(track.period(by) for track in self.tracks))

    def gap_ns(self, by: Any = LATER) -> Any:
        """Nanoseconds beyond which nothing is joined, by places."""
        return np.maximum(*(track.gap_ns(by) for track in self.tracks))

    def in_order(self, rows: Rows) -> int:
        """How many readings, from the first on, come after those before them."""
        count = len(rows.order)
        if not count:
            return 0
        for track, values in zip(self.tracks, rows.values[:2], strict=True):
            there = np.flatnonzero(~np.isnan(values))
            in_order = track.in_order(rows.stamps[there])
            if in_order < len(there):
                count = min(count, int(there[in_order]))
        return count

    def extend(self, rows: Rows) -> None:
        """Take V and A of readings in order, either NaN where not measured."""
        if not len(rows.order):
            return
        for track, values in zip(self.tracks, rows.values[:2], strict=True):
            there = ~np.isnan(values)
            track.extend(rows.order[there], rows.stamps[there], values[there])
        coarse = rows.values[FIELDS[BatteryReading].index("power_std")]
        self._orders = np.concatenate((self._orders, rows.order))
        self._power_std = np.concatenate((self._power_std, np.where(coarse > 0.0, coarse, 0.0)))

    def insert(self, reading: BatteryReading) -> bool:
        """Take a reading of any stamp between blocks; False when nothing was new."""
        new = False
        self._power_std[-1] = reading.power_std if reading.power_std > 0.0 else 0.0
        for track, value in zip(self.tracks, (reading.voltage, reading.current), strict=True):
            new |= not math.isnan(value) and track.insert(reading.stamp_ns, value)
        return new

    def settle(self, needed_ns: int) -> None:
        """See `SignalTrack.settle`."""
        for track in self.tracks:
            track.settle(needed_ns)
        if len(self._orders) > 1:
            self._orders, self._power_std = np.array([BEFORE]), self._power_std[-1:]

    def first_after(self, moments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First moments from which on both are known at others, and the places then.

        `LATER` while one of them is not.
        """
        stamps, orders = zip(*(track.first_after(moments) for track in self.tracks), strict=True)
        return np.maximum(*stamps), np.maximum(*orders)

    def at(self, moments: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Power drawn, W, at moments; NaN where it was not measured. Shape (n,)."""
        return drawn_power(self.voltage.at(moments, by), self.current.at(moments, by))

    def told(self, rows: Rows) -> np.ndarray:
        """Power that readings tell, W, or NaN; of a current alone, with the last voltage."""
        voltage, current = rows.values[:2]
        alone = np.isnan(voltage)
        last = self.voltage.last(rows.stamps[alone], rows.order[alone])
        voltage = voltage.copy()
        voltage[alone] = last
        return drawn_power(voltage, current)

    def covered(self, moments: np.ndarray, by: int = LATER) -> np.ndarray:
        """`SignalTrack.covered` of both, shape (n - 1,)."""
        return np.asarray(self.voltage.covered(moments, by) & self.current.covered(moments, by))

    def energy(self, start_ns: int, end_ns: int, by: int = LATER) -> Energy:
        """Energy drawn between two moments.

        The trapezoid between readings of the current. Power moves between them as it moves from
        one to the next, so its integral is uncertain as that of a Brownian bridge; and what a
        slow signal shows was so some part of its step ago, which moves the ends of the interval.
        Coarse readings that repeat have one error, the others each its own.
        """
        if not self.covered(np.array([start_ns, end_ns]), by)[0]:
            return UNMEASURED
        stamps = np.concatenate(([start_ns], self.current.within(start_ns, end_ns, by), [end_ns]))
        power = drawn_power(*(track.between(stamps, by) for track in self.tracks))
        step = np.diff(stamps) / NANOSECONDS
        bridge = BRIDGE_SHARE * float(np.diff(power) ** 2 @ step**2)
        period = max(track.step_around(end_ns, by) for track in self.tracks)
        ends = (TIMING * period) ** 2 * float(power[0] ** 2 + power[-1] ** 2)
        std = float(self._power_std[self._orders.searchsorted(by, side="right") - 1])
        coarse = std**2 * _square_of_runs(power, step) if std else 0.0
        returned = _trapezoid(np.maximum(-power, 0.0), step)
        return Energy(_trapezoid(power, step), bridge + ends + coarse, returned)


class MotorTrack:
    """Power at the motor shaft, W, positive when it drives, where a bus reports its torque."""

    def __init__(self, max_gap: float, ratio: float) -> None:
        """Take the motor's turning from its own speed, else from the car's.

        Args:
            max_gap: s, see `SignalTrack`.
            ratio: rad that the motor turns per m of road; `NOMINAL_RATIO` where it is NaN.
        """
        self.power = SignalTrack(max_gap)
        self._scaled_from = LATER if math.isnan(ratio) else BEFORE
        self._ratio = NOMINAL_RATIO if math.isnan(ratio) else ratio

    def scaled(self, by: Any = LATER) -> Any:
        """Whether it is in W; else up to a factor, for neither gear nor speed is known."""
        return np.less_equal(self._scaled_from, by) & (self._scaled_from < LATER)

    def powers(self, rows: Rows, car_speed: np.ndarray) -> np.ndarray:
        """Power of readings at speeds of the car, m/s, W; of any order."""
        torque, turning = rows.values
        known = ~np.isnan(turning)
        if known.any():
            self._scaled_from = min(self._scaled_from, int(rows.order[known][0]))
        return np.asarray(torque * np.where(known, turning, self._ratio * car_speed))

    def settle(self, needed_ns: int) -> None:
        """See `SignalTrack.settle`."""
        self.power.settle(needed_ns)
        self._scaled_from = BEFORE if self._scaled_from < LATER else LATER

    def at(self, moments: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Power at moments, W, that of the last reading where it is the newest; NaN unknown."""
        if not len(self.power):
            return np.full(len(moments), np.nan)
        come = self.power.count(by)
        newest = (come > 0) & (moments > self.power.stamps[np.maximum(come - 1, 0)])
        return np.where(newest, self.power.last(moments, by), self.power.at(moments, by))

    def energies(self, ends: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Energy of driving and of braking in steps, positive J; NaN where unknown.

        Args:
            ends: n + 1 moments, rising, ns.
            by: places in the order of arrival, shape (n,).

        Returns:
            Shape (2, n).
        """
        track = self.power
        if len(ends) < 2 or len(track) < 2:
            return np.full((2, len(by)), np.nan)
        first = track.stamps.searchsorted(ends[:-1], side="right") - 1
        last = track.stamps.searchsorted(ends[1:])
        covered = (first >= 0) & (last < track.count(by))
        first = np.clip(first, 0, len(track) - 2)
        around = np.column_stack((first, np.clip(last, first + 1, len(track) - 1)))
        widest = np.maximum.reduceat(np.append(np.diff(track.stamps), 0), around.ravel())[::2]
        covered &= widest <= track.gap_ns(by)
        within = slice(*track.stamps.searchsorted(ends[[0, -1]]))
        knots = np.union1d(ends, track.stamps[within])
        power = np.interp(knots - ends[0], track.stamps - ends[0], track.values)
        signed = np.maximum(np.stack((power, -power)), 0.0)
        steps = (signed[:, 1:] + signed[:, :-1]) * (np.diff(knots) / (2 * NANOSECONDS))
        energies = np.add.reduceat(steps, knots.searchsorted(ends[:-1]), axis=1)
        return np.where(covered, energies, np.nan)


def _trapezoid(power: np.ndarray, step: np.ndarray) -> float:
    return float((power[1:] + power[:-1]) @ step) / 2


def _square_of_runs(power: np.ndarray, step: np.ndarray) -> float:
    """Sum of the squares of the times, s, that equal readings in a row stand for."""
    stands_for = (np.append(step, 0.0) + np.concatenate(([0.0], step))) / 2.0
    run = np.concatenate(([0], np.cumsum(np.diff(power) != 0.0)))
    return float((np.bincount(run, stands_for) ** 2).sum())
