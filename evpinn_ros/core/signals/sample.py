"""Samples of driving, and what a block of readings completes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.kinematics import PROFILE


class Sample(NamedTuple):
    """Motion and surroundings of the car at one moment, without the battery.

    Attributes:
        stamp_ns: the moment.
        speed: m/s.
        acceleration: m/s^2.
        grade: road incline angle, rad, positive uphill; 0 while unknown.
        air_density: kg/m^3.
        known_auxiliary: power of auxiliary loads the car reports, W; 0 while unknown.
        profile: acceleration profile (`kinematics.profile`), shape (`kinematics.PROFILE`,), m/s^2;
            0 where unknown.
        head_wind: wind against the car, m/s over ground; 0 while unknown.
        celsius: temperature of the air outside, NaN while unknown.
        motor_power: mechanical power of the motor, W, NaN where no bus reports it.
        motor_scaled: True if `motor_power` is in W; False if an unknown gear ratio scales it.
    """

    stamp_ns: int
    speed: float
    acceleration: float
    grade: float
    air_density: float
    known_auxiliary: float
    profile: tuple[float, ...] = (0.0,) * PROFILE
    head_wind: float = 0.0
    celsius: float = math.nan
    motor_power: float = math.nan
    motor_scaled: bool = True


class Samples(NamedTuple):
    """n moments of driving: `Sample` as columns of shape (n,), the profile (n, PROFILE)."""

    stamp_ns: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    grade: np.ndarray
    air_density: np.ndarray
    known_auxiliary: np.ndarray
    profile: np.ndarray
    head_wind: np.ndarray
    celsius: np.ndarray
    motor_power: np.ndarray
    motor_scaled: np.ndarray

    @classmethod
    def of(cls, samples: Sequence[Sample]) -> Samples:
        """Columns of samples in their order."""
        if not samples:
            return NO_SAMPLES
        stamps, *columns = zip(*samples, strict=True)
        return cls._make((np.array(stamps, np.int64), *map(np.array, columns)))

    @property
    def size(self) -> int:
        """Number of samples."""
        return len(self.stamp_ns)

    def where(self, chosen: np.ndarray | slice) -> Samples:
        """The rows of a mask or slice."""
        return Samples._make([column[chosen] for column in self])

    def and_then(self, later: Samples) -> Samples:
        """These samples and `later` ones, concatenated."""
        return joined_samples((self, later))

    def rows(self) -> Iterator[Sample]:
        """Yields the samples one by one."""
        columns = [column.tolist() for column in self]
        columns[6] = [tuple(row) for row in columns[6]]
        return map(Sample, *columns)


NO_SAMPLES = Samples._make((
    np.empty(0, np.int64), *(np.empty(0) for _ in range(5)), np.empty((0, PROFILE)),
    *(np.empty(0) for _ in range(3)), np.empty(0, dtype=bool),
))  # fmt: skip


def joined_samples(parts: Sequence[Samples]) -> Samples:
    """Concatenated samples."""
    filled = [samples for samples in parts if samples.size]
    if len(filled) < 2:
        return filled[0] if filled else NO_SAMPLES
    return Samples._make(map(np.concatenate, zip(*filled, strict=True)))


class Measured(NamedTuple):
    """Smoothed samples whose battery power was measured, in order: to learn from.

    Attributes:
        samples: n of them.
        power: W, shape (n,).
        known_ns: stamp of the speed reading that completes each, shape (n,).
        place: number of the block's smoothed samples predicted before each is learned, shape (n,).
    """

    samples: Samples
    power: np.ndarray
    known_ns: np.ndarray
    place: np.ndarray

    def where(self, chosen: np.ndarray | slice) -> Measured:
        """The rows of a mask or slice."""
        return Measured(self.samples.where(chosen), *(column[chosen] for column in self[1:]))


class Newest(NamedTuple):
    """Samples of the newest speeds, which are predicted at once.

    Attributes:
        samples: n of them, whose acceleration is causal.
        known_ns: stamp up to which everything was learned before each, shape (n,).
        battery_ns: stamps of the newest battery reading before each, shape (n,).
        battery_power: power of that reading, W, NaN before any, shape (n,).
    """

    samples: Samples
    known_ns: np.ndarray
    battery_ns: np.ndarray
    battery_power: np.ndarray


class Events(NamedTuple):
    """What a block completes, up to the stamp of its newest speed.

    Attributes:
        newest: samples of the newest speeds, with causal acceleration (`power/predicted`).
        smoothed: m samples `smoothing_lag` back (`power/smoothed`).
        smoothed_ns: stamp of the speed that completes each, shape (m,).
        measured: smoothed samples whose battery power is known.
        intervals: to learn the car from, each after the stamp of the speed that completes it.
    """

    newest: Newest
    smoothed: Samples
    smoothed_ns: np.ndarray
    measured: Measured
    intervals: Sequence[tuple[int, Interval]]


NO_NS = np.empty(0, np.int64)
NO_NEWEST = Newest(NO_SAMPLES, NO_NS, NO_NS, np.empty(0))
NO_MEASURED = Measured(NO_SAMPLES, np.empty(0), NO_NS, NO_NS)
NO_EVENTS = Events(NO_NEWEST, NO_SAMPLES, NO_NS, NO_MEASURED, ())


def joined_events(parts: Sequence[Events]) -> Events:
    """Concatenated events of consecutive parts of a block."""
    if len(parts) == 1:
        return parts[0]
    places, count = [], 0
    for part in parts:
        places.append(part.measured.place + count)
        count += part.smoothed.size
    newest, measured = zip(*((part.newest, part.measured) for part in parts), strict=True)
    return Events(
        Newest(
            joined_samples([some.samples for some in newest]),
            *map(np.concatenate, zip(*(some[1:] for some in newest), strict=True)),
        ),
        joined_samples([part.smoothed for part in parts]),
        np.concatenate([part.smoothed_ns for part in parts]),
        Measured(
            joined_samples([some.samples for some in measured]),
            np.concatenate([some.power for some in measured]),
            np.concatenate([some.known_ns for some in measured]),
            np.concatenate(places),
        ),
        [interval for part in parts for interval in part.intervals],
    )
