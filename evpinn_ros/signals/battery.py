"""Voltage and current, each with its own stamps, as power at a moment and energy of an interval.

A polled car gives voltage and current at different times, a phone log every few seconds. Neither
is paired with the other by row: each is linear between its own readings, and their product is the
power. How far apart two readings may be to be joined follows the rate at which they come.
"""

from __future__ import annotations

from bisect import bisect_right
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.signals.readings import NANOSECONDS, drawn_power
from evpinn_ros.signals.track import SignalTrack

BRIDGE_SHARE = 1.0 / 12.0  # variance of the integral of a Brownian bridge, per step^2 and rise^2
TIMING = 0.2  # of a signal's usual step, 1-sigma by which its stamps are off


class Energy(NamedTuple):
    """Energy of an interval, J, and the variance that is due to sampling alone, J^2."""

    energy: float
    variance: float


class BatteryTrack:
    """Voltage and current of the latest seconds."""

    def __init__(self, max_gap: float) -> None:
        """Never interpolate across gaps (see `Cadence`)."""
        self._power_std = 0.0  # W, of a coarse reading
        self._voltage, self._current = SignalTrack(max_gap), SignalTrack(max_gap)

    @property
    def newest_ns(self) -> int | None:
        """Latest stamp up to which both are known, None before."""
        if not (self._voltage.stamps and self._current.stamps):
            return None
        return min(self._voltage.stamps[-1], self._current.stamps[-1])

    @property
    def period(self) -> float:
        """Usual step between readings of the slower of the two, s."""
        return max(self._voltage.cadence.period, self._current.cadence.period)

    @property
    def gap_ns(self) -> int:
        """Nanoseconds beyond which nothing is joined."""
        return max(self._voltage.cadence.gap_ns, self._current.cadence.gap_ns)

    def add(
        self, stamp_ns: int, voltage: float, current: float, power_std: float = math.nan
    ) -> bool:
        """Insert V and A, either NaN where not measured; False when nothing was new.

        `power_std` is that of a coarse reading, W, NaN of others.
        """
        new = False
        self._power_std = power_std if power_std > 0.0 else 0.0
        for track, value in ((self._voltage, voltage), (self._current, current)):
            new |= not math.isnan(value) and track.add(stamp_ns, value)
        return new

    def latest_voltage(self, stamp_ns: int) -> float | None:
        """Last voltage before a moment, V; None where it is too long ago."""
        index = bisect_right(self._voltage.stamps, stamp_ns) - 1
        if index < 0 or stamp_ns - self._voltage.stamps[index] > self._voltage.cadence.gap_ns:
            return None
        return self._voltage.values[index]

    def next_ns(self, stamp_ns: int) -> int | None:
        """First moment from which on both are known at `stamp_ns`, None while one is not."""
        after = [track.next_ns(stamp_ns) for track in (self._voltage, self._current)]
        known = [each for each in after if each is not None]
        return max(known) if len(known) == 2 else None

    def at(self, stamp_ns: int) -> float | None:
        """Power drawn, W, at a moment; None where it was not measured."""
        voltage, current = self._voltage.at(stamp_ns), self._current.at(stamp_ns)
        return None if voltage is None or current is None else drawn_power(voltage, current)

    def covers(self, start_ns: int, end_ns: int) -> bool:
        """True if power was measured from one moment to another without a gap."""
        return self._voltage.covers(start_ns, end_ns) and self._current.covers(start_ns, end_ns)

    def energy(self, start_ns: int, end_ns: int) -> Energy | None:
        """Energy drawn between two moments; None where it was not measured.

        The trapezoid between readings of the current. Power moves between them as it moves from
        one to the next, so its integral is uncertain as that of a Brownian bridge; and what a
        slow signal shows was so some part of its step ago, which moves the ends of the interval.
        Coarse readings that repeat have one error, the others each its own.
        """
        if not self.covers(start_ns, end_ns):
            return None
        stamps = [start_ns, *self._current.within(start_ns, end_ns), end_ns]
        powers = [self.at(stamp_ns) for stamp_ns in stamps]
        power = np.array([math.nan if each is None else each for each in powers])
        step = np.diff(stamps) / NANOSECONDS
        energy = float((power[1:] + power[:-1]) @ step) / 2
        bridge = BRIDGE_SHARE * float(np.diff(power) ** 2 @ step**2)
        period = max(track.step_around(end_ns) for track in (self._voltage, self._current))
        ends = (TIMING * period) ** 2 * float(power[0] ** 2 + power[-1] ** 2)
        coarse = self._power_std**2 * _square_of_runs(power, step) if self._power_std else 0.0
        return Energy(energy, bridge + ends + coarse) if math.isfinite(energy) else None


def _square_of_runs(power: np.ndarray, step: np.ndarray) -> float:
    """Sum of the squares of the times, s, that equal readings in a row stand for."""
    stands_for = (np.append(step, 0.0) + np.concatenate(([0.0], step))) / 2.0
    run = np.concatenate(([0], np.cumsum(np.diff(power) != 0.0)))
    return float((np.bincount(run, stands_for) ** 2).sum())
