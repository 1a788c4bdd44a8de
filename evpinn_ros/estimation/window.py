"""The samples an update learns from: the last seconds, and a spread of all that came before."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from evpinn_ros.signals.kinematics import COURSE
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample

SPEED_EDGES = (0.5, 3.0, 6.0, 9.0, 12.0, 15.0, 20.0, 25.0, 30.0, 35.0)  # m/s
ACCELERATION_EDGES = (-1.5, -0.7, -0.2, 0.2, 0.7, 1.5)  # m/s^2
BUCKET_SIZE = 12
BUCKET_STEP = 0.5  # s between two samples of one bucket, so that one manoeuvre cannot fill it


class Observation(NamedTuple):
    """One learned sample: what was measured and the unknown slope, rad, believed at its time."""

    sample: Sample
    power: float
    slope: float


class Batch(NamedTuple):
    """Observations as columns of shape (n,); `age` in s before the newest, rest SI.

    `course` has shape (n, `kinematics.COURSE`).
    """

    age: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    grade: np.ndarray
    air_density: np.ndarray
    known_auxiliary: np.ndarray
    power: np.ndarray
    slope: np.ndarray
    head_wind: np.ndarray
    course: np.ndarray


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

    def add(self, observation: Observation) -> list[Observation]:
        """Take one observation and give those that have become too old."""
        self._observations.append(observation)
        oldest = observation.sample.stamp_ns - int(self.duration * NANOSECONDS)
        left = []
        while self._observations[0].sample.stamp_ns < oldest:
            left.append(self._observations.popleft())
        return left

    def clear(self) -> None:
        """Forget all, after a jump of time."""
        self._observations.clear()


class SampleStore:
    """Past observations spread over speed and acceleration, the newest of each bucket.

    So that city driving is not forgotten on the motorway (openpilot's torqued keeps such buckets).
    """

    def __init__(self) -> None:
        self._buckets: dict[tuple[int, int], deque[Observation]] = {}

    def __iter__(self) -> Iterator[Observation]:
        for key in sorted(self._buckets):
            yield from self._buckets[key]

    def add(self, observation: Observation) -> None:
        """Take an observation that has left the window."""
        sample = observation.sample
        if sample.speed < SPEED_EDGES[0]:
            return
        key = (
            int(np.searchsorted(SPEED_EDGES, sample.speed, side="right")),
            int(np.searchsorted(ACCELERATION_EDGES, sample.acceleration)),
        )
        bucket = self._buckets.setdefault(key, deque(maxlen=BUCKET_SIZE))
        if bucket:
            step = sample.stamp_ns - bucket[-1].sample.stamp_ns
            if 0 <= step < int(BUCKET_STEP * NANOSECONDS):
                return
        bucket.append(observation)

    def coverage(self) -> float:
        """Share of the buckets of speed and acceleration that hold samples, 0..1."""
        return len(self._buckets) / (len(SPEED_EDGES) * (len(ACCELERATION_EDGES) + 1))


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
            slope,
            sample.head_wind,
        )
        for sample, power, slope in observations
    ]
    columns = np.array(rows, dtype=float).reshape(len(rows), len(Batch._fields) - 1).T
    unknown = (0.0,) * COURSE
    course = np.array([sample.course or unknown for sample, _, _ in observations])
    return Batch._make((*columns, course.reshape(len(rows), COURSE)))
