"""Sums over driving: terms of the one equation, and the noise that no state explains."""

from __future__ import annotations

from bisect import bisect_left
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.arrays import namespace
from evpinn_ros.core.estimation.states import SIZE
from evpinn_ros.core.estimation.terms import Equation, Warmth, conditions_of
from evpinn_ros.core.signals.interval import Interval, Steps
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import Sample
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED

LOAD_TIME = 300.0  # s in which the wandering load forgets itself
# Energy that no state explains, which forgets itself in `NOISE_TIME`: W, and N while moving.
NOISE_TIME, POWER_NOISE, FORCE_NOISE, TORQUE_NOISE = 1.5, 150.0, 40.0, 30.0
MAX_STEP = 10.0  # s that one sample may stand for
SAMPLES_KEPT = 1000  # that are remembered at least: intervals wait up to a minute for heights


class Journey(NamedTuple):
    """Sums over steps of driving, measured, unmeasured or planned; they add up.

    Attributes:
        row: energy by each state, J per unit, shape (SIZE,); of `State.LOAD` the seconds.
        seconds: s.
        noise: variance of what no state explains by its kinds, at scale 1, J^2, shape (3,).
        unseen: m of road whose height is not known.
    """

    row: np.ndarray
    seconds: float
    noise: np.ndarray
    unseen: float

    def plus(self, other: Journey) -> Journey:
        """Both, one after the other."""
        row, noise = self.row + other.row, self.noise + other.noise
        return Journey(row, self.seconds + other.seconds, noise, self.unseen + other.unseen)

    def less(self, other: Journey) -> Journey:
        """Without a part of it."""
        return self.plus(other.share(-1.0))

    def share(self, share: float) -> Journey:
        """A share of it."""
        row, noise = share * self.row, share * self.noise
        return Journey(row, share * self.seconds, noise, share * self.unseen)


NOWHERE = Journey(np.zeros(SIZE), 0.0, np.zeros(3), 0.0)


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
    seconds: Any, stood: Any, square: Any, *, force: float = FORCE_NOISE
) -> tuple[Any, Any]:
    """Variance of energy that no state explains, at scale 1, J^2, while standing and moving.

    They are kinds of their own, for how well the equation holds while driving, or the clocks of
    speed and battery agree, says nothing about a car that stands.

    Args:
        seconds: s, any shape, numpy or torch.
        stood: how many of them the car stands.
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
    """An Ornstein-Uhlenbeck process of variance 1 over so many s; any shape, numpy or torch.

    Returns:
        What is left of its value; the integral that its value now leads to, s; the variance of
        the rest of the integral, s^2.
    """
    xp = namespace(seconds)
    left = xp.exp(-seconds / LOAD_TIME)
    integral = LOAD_TIME * (1.0 - left)
    return left, integral, xp.clip(2.0 * LOAD_TIME * (seconds - integral) - integral**2, 0.0, None)


class Tail:
    """The newest samples, which no interval holds yet, as sums of which journeys are differences.

    A step's kinetic energy is an exact difference, as an interval's is. Nothing is computed
    before a journey is asked for, which is in dropouts alone.
    """

    def __init__(self, equation: Equation) -> None:
        """Nothing driven by a car."""
        self._equation = equation
        self._samples: list[Sample] = []
        self._stamps: list[int] = []
        self._sums: list[Journey] = []

    def add(self, sample: Sample) -> None:
        """Take the next sample."""
        if self._stamps and sample.stamp_ns <= self._stamps[-1]:
            return
        self._samples.append(sample)
        self._stamps.append(sample.stamp_ns)
        if len(self._stamps) >= 2 * SAMPLES_KEPT:
            for kept in (self._samples, self._stamps, self._sums):
                del kept[:SAMPLES_KEPT]

    def between(self, start_ns: int, end_ns: int, warmth: Warmth) -> Journey:
        """Journey from one stamp to another, as far as it is remembered."""
        if not self._stamps:
            return NOWHERE
        for index in range(len(self._sums), len(self._samples)):
            before = self._sums[-1] if self._sums else NOWHERE
            step = self._step(index, warmth) if self._sums else NOWHERE
            self._sums.append(before.plus(step))
        return self._until(end_ns).less(self._until(start_ns))

    def _step(self, index: int, warmth: Warmth) -> Journey:
        """The step that ends with a sample."""
        begin, end = self._samples[index - 1 : index + 1]
        seconds = min((end.stamp_ns - begin.stamp_ns) / NANOSECONDS, MAX_STEP)
        speed = (begin.speed + end.speed) / 2.0
        way, wind = abs(speed) * seconds, end.head_wind

        def drag(v: float) -> float:
            return (v + wind) * abs(v + wind) * abs(v)

        air = (drag(begin.speed) + 4.0 * drag(speed) + drag(end.speed)) / 6.0 * seconds
        kinetic = (end.speed**2 - begin.speed**2) / 2.0
        climb = speed * seconds * math.sin((begin.grade + end.grade) / 2.0)
        motor = np.array([1.0, -1.0]) * end.motor_power * seconds
        moved = seconds, way, air, kinetic, climb, *np.maximum(motor, 0.0)
        steps = Steps._make((*(np.array([moved_by]) for moved_by in moved), end.motor_scaled))
        rows = self._equation.rows(steps, conditions_of(end), warmth)
        unseen = 0.0 if end.grade or steps.motor_known else way
        return Journey(rows[0], seconds, noise_of(steps), unseen)

    def _until(self, stamp_ns: int) -> Journey:
        """The sum up to a stamp, with its share of the step that spans it."""
        after = bisect_left(self._stamps, stamp_ns)
        if after in (0, len(self._stamps)):
            return self._sums[min(after, len(self._stamps) - 1)]
        begin_ns, end_ns = self._stamps[after - 1 : after + 1]
        share = (stamp_ns - begin_ns) / (end_ns - begin_ns)
        before = self._sums[after - 1]
        return before.plus(self._sums[after].less(before).share(share))
