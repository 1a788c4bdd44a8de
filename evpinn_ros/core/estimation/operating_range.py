"""Data coverage: time learned from at each speed and acceleration.

A parameter that acts at speeds never driven is prior, whatever its value: drag wants a
motorway, mass wants acceleration.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

from evpinn_ros.core.signals.sample import Samples

SPEED_EDGES = np.array([30.0, 60.0, 90.0, 120.0])  # km/h
MANNER_EDGES = np.array([-0.3, 0.3])  # m/s^2, between braking, steady and accelerating
SPEEDS = ("0_30", "30_60", "60_90", "90_120", "over_120")
MANNERS = ("braking", "steady", "accelerating")


class OperatingRange:
    """Counts samples in a map of speed and acceleration."""

    def __init__(self) -> None:
        self._counts: Counter[tuple[int, int]] = Counter()

    def add(self, samples: Samples) -> None:
        """Count samples that were learned from."""
        speed = SPEED_EDGES.searchsorted(np.abs(samples.speed) * 3.6, side="right")
        manner = MANNER_EDGES.searchsorted(samples.acceleration, side="right")
        self._counts.update(zip(speed.tolist(), manner.tolist(), strict=True))

    def counts(self) -> Mapping[str, int]:
        """Samples by `<speed in km/h>_kmh_<manner>`, all of the map, zeros too."""
        return {
            f"{speed}_kmh_{manner}": self._counts[i, j]
            for i, speed in enumerate(SPEEDS)
            for j, manner in enumerate(MANNERS)
        }
