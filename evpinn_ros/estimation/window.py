"""The samples that an update of `mode: paper` learns from: those of the last seconds."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample


class Observation(NamedTuple):
    """One sample and its measured power, W."""

    sample: Sample
    power: float


class Batch(NamedTuple):
    """Observations as columns of shape (n,); `age` in s before the newest, rest SI."""

    age: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    grade: np.ndarray
    air_density: np.ndarray
    known_auxiliary: np.ndarray
    power: np.ndarray
    head_wind: np.ndarray


class SlidingWindow:
    """The observations of the last seconds."""

    def __init__(self, duration: float) -> None:
        """Keep this many seconds."""
        self.duration = duration
        self._observations: deque[Observation] = deque()

    def __len__(self) -> int:
        return len(self._observations)

    def __iter__(self) -> Iterator[Observation]:
        return iter(self._observations)

    def add(self, observation: Observation) -> None:
        """Take one observation, and drop those that have become too old."""
        self._observations.append(observation)
        oldest = observation.sample.stamp_ns - int(self.duration * NANOSECONDS)
        while self._observations[0].sample.stamp_ns < oldest:
            self._observations.popleft()

    def clear(self) -> None:
        """Forget all, after a jump of time."""
        self._observations.clear()


def batch(observations: Sequence[Observation], newest_ns: int) -> Batch:
    """Columns of the observations, for arithmetic on all at once."""
    rows = [
        (
            (newest_ns - sample.stamp_ns) / NANOSECONDS,
            sample.speed,
            sample.acceleration,
            sample.grade,
            sample.air_density,
            sample.known_auxiliary,
            power,
            sample.head_wind,
        )
        for sample, power in observations
    ]
    return Batch._make(np.array(rows, dtype=float).reshape(len(rows), len(Batch._fields)).T)
