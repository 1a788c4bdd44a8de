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
from evpinn_ros.core.signals.kinematics import SpeedTrack
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, drawn_power
from evpinn_ros.core.signals.track import LATER, NEVER, SignalTrack

BRIDGE_SHARE = 1.0 / 12.0  # variance of the integral of a Brownian bridge, per step^2 and rise^2
TIMING = 0.2  # 1-sigma of a signal's stamps as a share of its usual step
COARSE = FIELDS[BatteryReading].index("power_std")
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
        """Start empty; max_gap as in `SignalTrack`."""
        self.voltage, self.current = self.tracks = SignalTrack(max_gap), SignalTrack(max_gap)
        # W, 1-sigma by coarse resolution from each stamp on; 0 where it is fine.
        self._coarse_ns, self._coarse = np.array([NEVER]), np.zeros(1)

    @property
    def newest_ns(self) -> int:
        """Latest stamp up to which both are known; `NEVER` before."""
        return min(track.newest_ns for track in self.tracks)

    def newest_at(self, moments: np.ndarray) -> np.ndarray:
        """Latest stamps up to which both are known at moments, ns; `NEVER` before."""
        newest = []
        for track in self.tracks:
            stamps = np.append(NEVER, track.stamps)
            newest.append(stamps[stamps.searchsorted(moments, side="right") - 1])
        return np.asarray(np.minimum(*newest))

    def period(self, moments: Any = None) -> Any:
        """Usual step between readings of the slower of the two, s."""
        return np.maximum(*(track.period(moments) for track in self.tracks))

    def gap_ns(self, moments: Any = None) -> Any:
        """Nanoseconds beyond which nothing is joined, by the readings up to moments."""
        return np.maximum(*(track.gap_ns(moments) for track in self.tracks))

    def extend(self, rows: Rows) -> None:
        """Take V and A of the readings that follow, either NaN where not measured."""
        if not len(rows.stamps):
            return
        for track, values in zip(self.tracks, rows.values[:2], strict=True):
            there = ~np.isnan(values)
            track.extend(rows.stamps[there], values[there])
        coarse = rows.values[COARSE]
        coarse = np.where(np.isnan(coarse), 0.0, coarse)
        changes = np.concatenate((self._coarse[-1:], coarse))
        changes = changes[1:] != changes[:-1]
        if changes.any():
            self._coarse_ns = np.concatenate((self._coarse_ns, rows.stamps[changes]))
            self._coarse = np.concatenate((self._coarse, coarse[changes]))

    def forget_before(self, needed_ns: int) -> None:
        """Drop readings that no moment from `needed_ns` on rests on."""
        for track in self.tracks:
            track.forget_before(needed_ns)
        first = max(0, int(self._coarse_ns.searchsorted(needed_ns)) - 1)
        self._coarse_ns, self._coarse = self._coarse_ns[first:], self._coarse[first:]

    def first_after(self, moments: np.ndarray) -> np.ndarray:
        """When both are known from `moments` on, ns; `LATER` while one is not."""
        return np.asarray(np.maximum(*(track.first_after(moments) for track in self.tracks)))

    def at(self, moments: np.ndarray) -> np.ndarray:
        """Power drawn, W, at moments; NaN where it was not measured. Shape (n,)."""
        return drawn_power(self.voltage.at(moments), self.current.at(moments))

    def covered(self, moments: np.ndarray) -> np.ndarray:
        """`SignalTrack.covered` of both, shape (n - 1,)."""
        return np.asarray(self.voltage.covered(moments) & self.current.covered(moments))

    def energy(self, start_ns: int, end_ns: int) -> Energy:
        """Energy drawn between two moments.

        Trapezoids between readings of the current. Between two readings power varies like a
        Brownian bridge, scaled by their difference; a slow signal's stamps are off by part of its
        step, which moves the ends of the interval. Repeated coarse readings share one error;
        others have independent errors.
        """
        if not self.covered(np.array([start_ns, end_ns]))[0]:
            return UNMEASURED
        stamps = np.concatenate(([start_ns], self.current.within(start_ns, end_ns), [end_ns]))
        power = drawn_power(*(track.between(stamps) for track in self.tracks))
        step = np.diff(stamps) / NANOSECONDS
        bridge = BRIDGE_SHARE * float(np.diff(power) ** 2 @ step**2)
        period = max(track.step_around(end_ns) for track in self.tracks)
        ends = (TIMING * period) ** 2 * float(power[0] ** 2 + power[-1] ** 2)
        std = float(self._coarse[self._coarse_ns.searchsorted(end_ns, side="right") - 1])
        coarse = std**2 * _square_of_runs(power, step) if std else 0.0
        returned = _trapezoid(np.maximum(-power, 0.0), step)
        return Energy(_trapezoid(power, step), bridge + ends + coarse, returned)


class MotorTrack:
    """Power at the motor shaft, W, positive when it drives, where a bus reports its torque."""

    def __init__(self, max_gap: float, ratio: float) -> None:
        """Start empty; a reading without motor speed takes the car's speed times `ratio`.

        Args:
            max_gap: s, see `SignalTrack`.
            ratio: rad that the motor turns per m of road; if NaN, `NOMINAL_RATIO`.
        """
        self.power = SignalTrack(max_gap)
        self._scaled_from = LATER if math.isnan(ratio) else NEVER
        self._ratio = NOMINAL_RATIO if math.isnan(ratio) else ratio

    def scaled(self, moments: Any) -> Any:
        """True where power is in W; False where an unknown gear ratio scales it."""
        return np.less_equal(self._scaled_from, moments)

    def extend(self, rows: Rows, speed: SpeedTrack) -> None:
        """Take the readings that follow; those before the first speed are ignored."""
        index = speed.stamps.searchsorted(rows.stamps, side="right") - 1
        rows, index = rows.where(index >= 0), index[index >= 0]
        self.power.extend(rows.stamps, self.powers(rows, speed.values[index]))

    def powers(self, rows: Rows, car_speed: np.ndarray) -> np.ndarray:
        """Power of readings, W, shape (n,), at speeds of the car, m/s, shape (n,)."""
        torque, turning = rows.values
        known = ~np.isnan(turning)
        if known.any():
            self._scaled_from = min(self._scaled_from, int(rows.stamps[known][0]))
        return np.asarray(torque * np.where(known, turning, self._ratio * car_speed))

    def at(self, moments: np.ndarray, until: np.ndarray) -> np.ndarray:
        """Power at moments, W, from readings up to `until`, ns: the last one if none is later."""
        if not len(self.power):
            return np.full(len(moments), np.nan)
        between = self.power.first_after(moments) <= until
        return np.where(between, self.power.at(moments), self.power.last(moments))

    def energies(self, ends: np.ndarray) -> np.ndarray:
        """Energy of driving and of braking in steps between n + 1 moments, J, shape (2, n).

        Both are positive; NaN where unknown. The moments, ns, rise.
        """
        track, count = self.power, max(len(ends) - 1, 0)
        if not count or len(track) < 2:
            return np.full((2, count), np.nan)
        covered = track.covered(ends)
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
    """Sum of the squared durations, s^2, of runs of equal readings."""
    stands_for = (np.append(step, 0.0) + np.concatenate(([0.0], step))) / 2.0
    run = np.concatenate(([0], np.cumsum(np.diff(power) != 0.0)))
    return float((np.bincount(run, stands_for) ** 2).sum())
