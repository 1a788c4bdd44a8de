"""Power of battery and motor over the latest seconds, at a moment and as energy of an interval.

A polled car gives voltage and current at different times, a phone log every few seconds. Neither
is paired with the other by row: each is linear between its own readings, and their product is the
power. How far apart two readings may be to be joined follows the rate at which they come.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.readings import NANOSECONDS, MotorReading, drawn_power
from evpinn_ros.core.signals.track import SignalTrack

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
        """Never interpolate across gaps (see `Cadence`)."""
        self._power_std = 0.0  # W, of a coarse reading
        self._voltage, self._current = self._tracks = SignalTrack(max_gap), SignalTrack(max_gap)

    @property
    def newest_ns(self) -> int | None:
        """Latest stamp up to which both are known, None before."""
        if not (self._voltage.stamps and self._current.stamps):
            return None
        return min(self._voltage.stamps[-1], self._current.stamps[-1])

    @property
    def period(self) -> float:
        """Usual step between readings of the slower of the two, s."""
        return max(track.cadence.period for track in self._tracks)

    @property
    def gap_ns(self) -> int:
        """Nanoseconds beyond which nothing is joined."""
        return max(track.cadence.gap_ns for track in self._tracks)

    def add(
        self, stamp_ns: int, voltage: float, current: float, power_std: float = math.nan
    ) -> bool:
        """Insert V and A, either NaN where not measured; False when nothing was new.

        `power_std` is that of a coarse reading, W, NaN of others.
        """
        new = False
        self._power_std = power_std if power_std > 0.0 else 0.0
        for track, value in zip(self._tracks, (voltage, current), strict=True):
            new |= not math.isnan(value) and track.add(stamp_ns, value)
        return new

    def latest_voltage(self, stamp_ns: int) -> float:
        """Last voltage before a moment, V; NaN where it is too long ago."""
        return self._voltage.last(stamp_ns)

    def next_ns(self, stamp_ns: int) -> int | None:
        """First moment from which on both are known at `stamp_ns`, None while one is not."""
        after = [track.next_ns(stamp_ns) for track in self._tracks]
        known = [stamp_ns for stamp_ns in after if stamp_ns is not None]
        return max(known) if len(known) == 2 else None

    def at(self, stamp_ns: int) -> float:
        """Power drawn, W, at a moment; NaN where it was not measured."""
        return drawn_power(self._voltage.at(stamp_ns), self._current.at(stamp_ns))

    def covers(self, start_ns: int, end_ns: int) -> bool:
        """True if power was measured from one moment to another without a gap."""
        return bool(self.covered([start_ns, end_ns])[0])

    def covered(self, moments: Sequence[int]) -> np.ndarray:
        """`SignalTrack.covered` of both, shape (n - 1,)."""
        return np.asarray(self._voltage.covered(moments) & self._current.covered(moments))

    def energy(self, start_ns: int, end_ns: int) -> Energy:
        """Energy drawn between two moments.

        The trapezoid between readings of the current. Power moves between them as it moves from
        one to the next, so its integral is uncertain as that of a Brownian bridge; and what a
        slow signal shows was so some part of its step ago, which moves the ends of the interval.
        Coarse readings that repeat have one error, the others each its own.
        """
        if not self.covers(start_ns, end_ns):
            return UNMEASURED
        stamps = [start_ns, *self._current.within(start_ns, end_ns), end_ns]
        power = drawn_power(*(track.between(stamps) for track in self._tracks))
        step = np.diff(stamps) / NANOSECONDS
        bridge = BRIDGE_SHARE * float(np.diff(power) ** 2 @ step**2)
        period = max(track.step_around(end_ns) for track in self._tracks)
        ends = (TIMING * period) ** 2 * float(power[0] ** 2 + power[-1] ** 2)
        coarse = self._power_std**2 * _square_of_runs(power, step) if self._power_std else 0.0
        returned = _trapezoid(np.maximum(-power, 0.0), step)
        return Energy(_trapezoid(power, step), bridge + ends + coarse, returned)


class MotorTrack:
    """Power at the motor shaft, W, positive when it drives, where a bus reports its torque.

    Attributes:
        scaled: whether it is in W; else up to a factor, for neither gear nor speed is known.
    """

    def __init__(self, max_gap: float, ratio: float) -> None:
        """Take the motor's turning from its own speed, else from the car's.

        Args:
            max_gap: s, see `Cadence`.
            ratio: rad that the motor turns per m of road; `NOMINAL_RATIO` where it is NaN.
        """
        self._power = SignalTrack(max_gap)
        self.scaled = not math.isnan(ratio)
        self._ratio = ratio if self.scaled else NOMINAL_RATIO

    def add(self, reading: MotorReading, car_speed: float) -> None:
        """Take a reading at a speed of the car, m/s."""
        known = not math.isnan(reading.speed)
        self.scaled = self.scaled or known
        turning = reading.speed if known else self._ratio * car_speed
        self._power.add(reading.stamp_ns, reading.torque * turning)

    def at(self, stamp_ns: int) -> float:
        """Power at a moment, W, that of the last reading where it is the newest; NaN unknown."""
        stamps = self._power.stamps
        newest = bool(stamps) and stamp_ns > stamps[-1]
        return self._power.last(stamp_ns) if newest else self._power.at(stamp_ns)

    def energy(self, start_ns: int, end_ns: int) -> tuple[float, float]:
        """Energy of driving and of braking between two moments, positive J; NaN where unknown."""
        if not self._power.covers(start_ns, end_ns):
            return math.nan, math.nan
        stamps = [start_ns, *self._power.within(start_ns, end_ns), end_ns]
        power = self._power.between(stamps)
        step = np.diff(stamps) / NANOSECONDS
        drive, brake = np.maximum(power, 0.0), np.maximum(-power, 0.0)
        return _trapezoid(drive, step), _trapezoid(brake, step)


def _trapezoid(power: np.ndarray, step: np.ndarray) -> float:
    return float((power[1:] + power[:-1]) @ step) / 2


def _square_of_runs(power: np.ndarray, step: np.ndarray) -> float:
    """Sum of the squares of the times, s, that equal readings in a row stand for."""
    stands_for = (np.append(step, 0.0) + np.concatenate(([0.0], step))) / 2.0
    run = np.concatenate(([0], np.cumsum(np.diff(power) != 0.0)))
    return float((np.bincount(run, stands_for) ** 2).sum())
