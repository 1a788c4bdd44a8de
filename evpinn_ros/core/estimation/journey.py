"""Sums over driving: terms of the one equation, and the noise that no state explains."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.arrays import namespace
from evpinn_ros.core.estimation.states import SIZE
from evpinn_ros.core.estimation.terms import Equation, Warmth
from evpinn_ros.core.signals.interval import Interval, Steps
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import NO_SAMPLES, Samples, joined_samples
from evpinn_ros.core.signals.track import NEVER
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED

LOAD_TIME = 300.0  # s, time constant of the wandering load
# Energy that no state explains, correlated within `NOISE_TIME`: W, and N while moving.
NOISE_TIME, POWER_NOISE, FORCE_NOISE, TORQUE_NOISE = 1.5, 150.0, 40.0, 30.0
MAX_STEP = 10.0  # s that one sample may stand for
SAMPLES_KEPT = 1000  # that are remembered at least: intervals wait up to a minute for heights


class Journey(NamedTuple):
    """Sums over steps of driving, measured, unmeasured or planned; they add up.

    Attributes:
        row: energy by each state, J per unit, shape (..., SIZE); of `State.LOAD` the seconds.
        seconds: s.
        noise: variance of energy that no state explains (`noise_of`), J^2, shape (..., 3).
        unseen: m of road whose height is not known.
    """

    row: np.ndarray
    seconds: Any
    noise: np.ndarray
    unseen: Any

    def plus(self, other: Journey) -> Journey:
        """The journey followed by another."""
        row, noise = self.row + other.row, self.noise + other.noise
        return Journey(row, self.seconds + other.seconds, noise, self.unseen + other.unseen)

    def less(self, other: Journey) -> Journey:
        """The journey without a part of it."""
        return self.plus(other.share(-1.0))

    def share(self, share: float) -> Journey:
        """A share of the journey."""
        row, noise = share * self.row, share * self.noise
        return Journey(row, share * self.seconds, noise, share * self.unseen)


NOWHERE = Journey(np.zeros(SIZE), 0.0, np.zeros(3), 0.0)
NOWHERE_ARRAYS = tuple(map(np.asarray, NOWHERE))


def journey_of(interval: Interval, row: np.ndarray) -> Journey:
    """One interval as a journey, with its row of `Equation.rows`, summed, shape (SIZE,)."""
    unseen = 0.0 if interval.steps.motor_known else unseen_of(interval)
    return Journey(row, interval.duration, noise_of(interval.steps), unseen)


def unseen_of(interval: Interval) -> float:
    """Road of an interval whose height is not known, m."""
    return 0.0 if interval.height_known else abs(interval.distance)


def standing(duration: Any, distance: Any) -> Any:
    """Seconds of each step in which the car stands; any shape, numpy or torch."""
    return duration * (abs(distance) < STANDSTILL_SPEED * duration)


def speed_squared(steps: Steps) -> float:
    """Integral of speed squared over all steps, m^2/s."""
    return float(steps.distance**2 @ (1.0 / steps.duration))


def unexplained(
    seconds: Any, stood: Any, square: Any, *, force: Any = FORCE_NOISE
) -> tuple[Any, Any]:
    """Variance of energy that no state explains, at scale 1, J^2, while standing and moving.

    They are separate kinds: errors of the equation and of the clocks while driving say nothing
    about a car that stands.

    Args:
        seconds: s, any shape, numpy or torch.
        stood: seconds of these in which the car stands.
        square: integral of speed squared, m^2/s.
        force: 1-sigma while moving, N.
    """
    moving = POWER_NOISE**2 * (seconds - stood) + force**2 * square
    return NOISE_TIME * POWER_NOISE**2 * stood, NOISE_TIME * moving


def noise_of(steps: Steps) -> np.ndarray:
    """`unexplained` of steps together, J^2, shape (3,): standing, moving, moving with torque."""
    stood = float(standing(steps.duration, steps.distance).sum())
    sums = float(steps.duration.sum()), stood, speed_squared(steps)
    if steps.motor_known:
        still, moving = unexplained(*sums, force=TORQUE_NOISE)
        return np.array((still, 0.0, moving))
    return np.array((*unexplained(*sums), 0.0))


def wandered(seconds: Any) -> tuple[Any, Any, Any]:
    """An Ornstein-Uhlenbeck process of variance 1 after `seconds`; any shape, numpy or torch.

    Returns:
        The share of its value that is left; the integral expected from its present value, s; the
        variance of the rest of the integral, s^2.
    """
    xp = namespace(seconds)
    left = xp.exp(-seconds / LOAD_TIME)
    integral = LOAD_TIME * (1.0 - left)
    return left, integral, xp.clip(2.0 * LOAD_TIME * (seconds - integral) - integral**2, 0.0, None)


class Tail:
    """Cumulative sums over the newest samples, which no interval holds yet.

    Journeys are differences of these sums. Kinetic energy is exact, as in intervals. Sums are
    computed when a journey is asked for, which is in dropouts alone.
    """

    def __init__(self, equation: Equation) -> None:
        """Start without samples."""
        self._equation = equation
        self._samples, self._newest_ns = NO_SAMPLES, NEVER
        self._later: list[Samples] = []
        self._waiting = 0  # samples in `_later`
        self._sums = Journey(np.empty((0, SIZE)), np.empty(0), np.empty((0, 3)), np.empty(0))

    def extend(self, samples: Samples) -> None:
        """Take the samples that follow."""
        if samples.size and samples.stamp_ns[0] <= self._newest_ns:
            samples = samples.where(samples.stamp_ns > self._newest_ns)
        if not samples.size:
            return
        self._newest_ns = int(samples.stamp_ns[-1])
        self._later.append(samples)
        self._waiting += samples.size
        if self._waiting > SAMPLES_KEPT:
            self._join()

    def _join(self) -> None:
        """Append `_later` to the samples, of which only the latest are kept."""
        self._samples = joined_samples((self._samples, *self._later))
        self._later.clear()
        self._waiting = 0
        surplus = self._samples.size - 2 * SAMPLES_KEPT
        if surplus > SAMPLES_KEPT:
            self._samples = self._samples.where(slice(surplus, None))
            self._sums = Journey(*(column[surplus:] for column in self._sums))

    def between(self, start_ns: int, ends: np.ndarray, warmth: Warmth) -> Journey:
        """Journeys from one stamp to n others, within the samples that are kept."""
        self._join()
        stamps = self._samples.stamp_ns
        if not len(stamps):
            return Journey(*(np.repeat(column[None], len(ends), 0) for column in NOWHERE_ARRAYS))
        self._sum(int(np.searchsorted(stamps, ends.max())) + 1, warmth)
        return self._until(ends).less(self._until(np.array([start_ns])))

    def _sum(self, count: int, warmth: Warmth) -> None:
        """Compute the sums over the first `count` samples."""
        summed, count = len(self._sums.seconds), min(count, self._samples.size)
        if count <= summed:
            return
        first = max(summed - 1, 0)
        steps = self._steps(self._samples.where(slice(first, count)), warmth)
        before = (
            (column[-1:] for column in self._sums) if summed else (c[None] for c in NOWHERE_ARRAYS)
        )
        new = (
            np.cumsum(np.concatenate(pair), axis=0)[bool(summed) :]
            for pair in zip(before, steps, strict=True)
        )
        self._sums = Journey(*map(np.concatenate, zip(self._sums, new, strict=True)))

    def _steps(self, samples: Samples, warmth: Warmth) -> Journey:
        """The steps between samples, shape (n - 1,) each."""
        end = samples.where(slice(1, None))
        seconds = np.minimum(np.diff(samples.stamp_ns) / NANOSECONDS, MAX_STEP)
        before, after = samples.speed[:-1], samples.speed[1:]
        speed = (before + after) / 2.0
        way, wind = np.abs(speed) * seconds, end.head_wind

        def drag(v: np.ndarray) -> np.ndarray:
            return np.asarray((v + wind) * np.abs(v + wind) * np.abs(v))

        air = (drag(before) + 4.0 * drag(speed) + drag(after)) / 6.0 * seconds
        kinetic = (after**2 - before**2) / 2.0
        climb = speed * seconds * np.sin((samples.grade[:-1] + end.grade) / 2.0)
        motor = end.motor_power * seconds
        drive, brake = np.maximum(motor, 0.0), np.maximum(-motor, 0.0)
        moved = seconds, way, air, kinetic, climb, drive, brake
        rows = self._equation.rows_along(moved, end, warmth)
        torque = ~np.isnan(motor)
        stood, square = standing(seconds, way), way**2 / np.maximum(seconds, 1e-9)
        force = np.where(torque, TORQUE_NOISE, FORCE_NOISE)
        still, moving = unexplained(seconds, stood, square, force=force)
        kinds = still, np.where(torque, 0.0, moving), np.where(torque, moving, 0.0)
        unseen = np.where((end.grade != 0.0) | torque, 0.0, way)
        return Journey(rows, seconds, np.stack(kinds, axis=1), unseen)

    def _until(self, stamps: np.ndarray) -> Journey:
        """The sums up to stamps, linear within steps."""
        times = self._samples.stamp_ns[: len(self._sums.seconds)]
        after = np.clip(np.searchsorted(times, stamps), 0, len(times) - 1)
        before = np.maximum(after - 1, 0)
        step = np.maximum(times[after] - times[before], 1)
        share = np.clip((stamps - times[before]) / step, 0.0, 1.0)

        def part(column: np.ndarray) -> np.ndarray:
            along = share.reshape(-1, *(1 for _ in column.shape[1:]))
            return np.asarray(column[before] + along * (column[after] - column[before]))

        return Journey(*map(part, self._sums))
