"""Sums over driving: terms of the one equation, and the noise that no state explains."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.arrays import namespace
from evpinn_ros.estimation.states import SIZE
from evpinn_ros.signals.interval import Interval, Steps
from evpinn_ros.vehicle.physics import STANDSTILL_SPEED

LOAD_TIME = 300.0  # s in which the wandering load forgets itself
# Energy that no state explains, which forgets itself in `NOISE_TIME`: W, and N while moving.
NOISE_TIME, POWER_NOISE, FORCE_NOISE, TORQUE_NOISE = 1.5, 150.0, 40.0, 30.0


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
