"""Energy that published power still owes the intervals, and how unsure what it gave is."""

from __future__ import annotations

from collections import deque

import numpy as np

from evpinn_ros.signals.readings import NANOSECONDS

MAX_STEP = 10.0  # s one sample may stand for
# s over which power makes up for what the intervals show it missed; within 10 s that costs more
# RMSE than it brings energy.
CATCH_UP = 60.0
HISTORY = 1000  # published samples that intervals are compared with


class EnergyDebt:
    """Power that makes up for what the intervals show the published power missed.

    Intervals have heights around a place and exact kinetic energy, but end some seconds ago. While
    the battery drops out, published power is moved so that its integral follows theirs. What was
    published since the last interval is as uncertain as it was then.
    """

    def __init__(self) -> None:
        """Nothing owed."""
        self._history: deque[tuple[int, float, float]] = deque(maxlen=HISTORY)
        self._energy = self._sigma = self._start = self._paid = self._owed = 0.0
        self._start_ns = 0

    def repay(self, stamp_ns: int, power: float, sigma: float) -> float:
        """Correction to add to a power, W, at a moment; `sigma`, W, is of the kind that lasts."""
        step = 0.0
        if self._history:
            step = min(max((stamp_ns - self._history[-1][0]) / NANOSECONDS, 0.0), MAX_STEP)
        self._energy += power * step
        self._sigma += sigma * step
        self._history.append((stamp_ns, self._energy, self._sigma))
        rate = (self._owed - self._paid) / max(CATCH_UP, step)
        self._paid += rate * step
        return rate

    def owe(self, start_ns: int, end_ns: int, energy: float) -> None:
        """Account for the energy, J, of the intervals of a dropout: from its begin until now."""
        if start_ns != self._start_ns:
            self._start_ns, self._start, self._paid = start_ns, self._at(start_ns)[0], 0.0
        self._owed = energy - (self._at(end_ns)[0] - self._start)

    def sigma_since(self, stamp_ns: int) -> float:
        """1-sigma of the energy published since a moment, J."""
        return self._sigma - self._at(stamp_ns)[1]

    def _at(self, stamp_ns: int) -> tuple[float, float]:
        """Energy that published power has until a moment, J, and sum of its sigmas, J."""
        if not self._history:
            return self._energy, self._sigma
        stamps, energies, sigmas = zip(*self._history, strict=True)
        energy, sigma = (np.interp(stamp_ns, stamps, values) for values in (energies, sigmas))
        return float(energy), float(sigma)
