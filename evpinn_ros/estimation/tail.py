"""The newest samples of driving as journeys: what no interval holds yet."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

from evpinn_ros.estimation.posterior import NOWHERE, Journey, unexplained
from evpinn_ros.signals.readings import NANOSECONDS

MAX_STEP = 10.0  # s that one sample may stand for
KEPT = 1000  # samples that are remembered at least: intervals wait up to a minute for heights


class Tail:
    """Sums of the samples so far, of which journeys are differences."""

    def __init__(self) -> None:
        """Nothing driven."""
        self._stamps: list[int] = []
        self._sums: list[Journey] = []

    def add(self, stamp_ns: int, row: np.ndarray, speed: float, *, height: bool) -> None:
        """Take a sample: its row of power, W per unit, shape (SIZE,), and speed, m/s.

        Args:
            stamp_ns: of the sample.
            row: of `Equation.row_of`.
            speed: m/s.
            height: whether the grade is known.
        """
        step, whole = 0.0, NOWHERE
        if self._stamps:
            whole = self._sums[-1]
            step = min(max((stamp_ns - self._stamps[-1]) / NANOSECONDS, 0.0), MAX_STEP)
        unseen = 0.0 if height else abs(speed) * step
        own = Journey(row * step, step, unexplained(step, speed**2 * step), unseen)
        self._stamps.append(stamp_ns)
        self._sums.append(whole.plus(own))
        if len(self._stamps) >= 2 * KEPT:
            del self._stamps[:KEPT], self._sums[:KEPT]

    def between(self, start_ns: int, end_ns: int) -> Journey:
        """Journey from one stamp to another, as far as it is remembered."""
        if not self._sums:
            return NOWHERE
        return self._until(end_ns).less(self._until(start_ns))

    def _until(self, stamp_ns: int) -> Journey:
        """The sum up to a stamp, with its share of the step that spans it."""
        after = bisect_left(self._stamps, stamp_ns)
        if after in (0, len(self._stamps)):
            return self._sums[min(after, len(self._stamps) - 1)]
        begin_ns, end_ns = self._stamps[after - 1 : after + 1]
        share = (stamp_ns - begin_ns) / (end_ns - begin_ns)
        before = self._sums[after - 1]
        return before.plus(self._sums[after].less(before).share(share))
