"""The latest readings of one quantity, and the rate at which they come."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Sequence
import math

import numpy as np

from evpinn_ros.core.signals.readings import NANOSECONDS

TRACK_LENGTH = 90.0  # s of readings kept; an interval waits no longer for its energy
RATE_READINGS = 15  # steps whose median is the rate of a signal
GAP_STEPS = 6.0  # median steps across which readings are still joined


class Cadence:
    """The usual step between readings of one signal, from the latest ones."""

    def __init__(self, max_gap: float) -> None:
        """Join readings up to max_gap, s, apart, and slow ones up to `GAP_STEPS` usual steps."""
        self._max_gap = max_gap
        self._steps: deque[float] = deque(maxlen=RATE_READINGS)
        self._period: float | None = 0.0  # None until it is asked for after a step

    @property
    def period(self) -> float:
        """Usual step, s; 0 before the second reading."""
        if self._period is None:
            self._period = sorted(self._steps)[len(self._steps) // 2]
        return self._period

    @property
    def gap_ns(self) -> int:
        """Nanoseconds between readings beyond which nothing is joined."""
        return int(max(self._max_gap, GAP_STEPS * self.period) * NANOSECONDS)

    def add_step(self, step: float) -> None:
        """Take the time, s, from one reading to the next."""
        self._steps.append(step)
        self._period = None


class SignalTrack:
    """The latest readings of one quantity in order of stamps.

    Attributes:
        cadence: their rate, and the gap across which none are joined.
        stamps: ns.
        values: of the same length.
    """

    def __init__(self, max_gap: float) -> None:
        """Join readings up to max_gap, s, apart, and slow ones as `Cadence` allows."""
        self.cadence = Cadence(max_gap)
        self.stamps: list[int] = []
        self.values: list[float] = []

    def add(self, stamp_ns: int, value: float) -> bool:
        """Insert one value in order; False when this stamp is already there."""
        index = bisect_left(self.stamps, stamp_ns)
        if index < len(self.stamps) and self.stamps[index] == stamp_ns:
            return False
        if index == len(self.stamps) and index:
            self.cadence.add_step((stamp_ns - self.stamps[-1]) / NANOSECONDS)
        self.stamps.insert(index, stamp_ns)
        self.values.insert(index, value)
        oldest = self.stamps[-1] - int(TRACK_LENGTH * NANOSECONDS)
        if self.stamps[len(self.stamps) // 2] < oldest:  # halved at once: deleting is not free
            surplus = bisect_left(self.stamps, oldest)
            del self.stamps[:surplus], self.values[:surplus]
        return True

    def next_ns(self, stamp_ns: int) -> int | None:
        """Stamp of the first reading at a moment or after it, None while there is none."""
        index = bisect_left(self.stamps, stamp_ns)
        return self.stamps[index] if index < len(self.stamps) else None

    def last(self, stamp_ns: int) -> float:
        """Last value at a moment or before it; NaN where it is too long ago."""
        index = bisect_right(self.stamps, stamp_ns) - 1
        if index < 0 or stamp_ns - self.stamps[index] > self.cadence.gap_ns:
            return math.nan
        return self.values[index]

    def at(self, stamp_ns: int) -> float:
        """Value at a moment, linear between its neighbours; NaN where it was not measured."""
        index = bisect_left(self.stamps, stamp_ns)
        if index == len(self.stamps):
            return math.nan
        if self.stamps[index] == stamp_ns:
            return self.values[index]
        if index == 0 or self.stamps[index] - self.stamps[index - 1] > self.cadence.gap_ns:
            return math.nan
        before, after = self.stamps[index - 1], self.stamps[index]
        share = (stamp_ns - before) / (after - before)
        return self.values[index - 1] + share * (self.values[index] - self.values[index - 1])

    def covers(self, start_ns: int, end_ns: int) -> bool:
        """True if readings around and within a span leave no gap."""
        return bool(self.covered([start_ns, end_ns])[0])

    def covered(self, moments: Sequence[int]) -> np.ndarray:
        """Whether readings around and within each step between n moments leave no gap.

        The moments, ns, rise; shape (n - 1,).
        """
        stamps = self._around(moments)[0]
        if not len(stamps):
            return np.zeros(len(moments) - 1, dtype=bool)
        gaps = np.append(0, np.cumsum(np.diff(stamps) > self.cadence.gap_ns))
        first = np.searchsorted(stamps, moments[:-1], side="right") - 1
        last = np.searchsorted(stamps, moments[1:])
        inside = (first >= 0) & (last < len(stamps))
        return np.asarray(inside & (gaps[np.minimum(last, len(gaps) - 1)] == gaps[first]))

    def between(self, moments: Sequence[int]) -> np.ndarray:
        """Values at n moments in order, linear between readings on both sides, shape (n,)."""
        stamps, values = self._around(moments)
        zero_ns = moments[0]
        return np.asarray(np.interp(np.array(moments) - zero_ns, stamps - zero_ns, values))

    def _around(self, moments: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Stamps, ns, and values of the readings around and within moments in order."""
        first = max(0, bisect_right(self.stamps, moments[0]) - 1)
        last = bisect_left(self.stamps, moments[-1]) + 1
        return np.array(self.stamps[first:last], np.int64), np.array(self.values[first:last])

    def step_around(self, stamp_ns: int) -> float:
        """Usual step between the readings up to a moment, s, whatever their order of arrival."""
        last = bisect_left(self.stamps, stamp_ns) + 1
        latest = self.stamps[max(0, last - RATE_READINGS - 1) : last]
        return float(np.median(np.diff(latest))) / NANOSECONDS if len(latest) > 1 else 0.0

    def within(self, start_ns: int, end_ns: int) -> list[int]:
        """Stamps strictly between two moments."""
        first, last = bisect_right(self.stamps, start_ns), bisect_left(self.stamps, end_ns)
        return self.stamps[first:last]
