"""Battery energy of some seconds by where it went, and the gradient of each part by the states.

The parts add up to `weak_form.spent`. At the wheels there are air (with the unseen force: wind
and traffic), tyres, slope and speed; each gives back what it took when the road falls or the car
slows. What is lost on the way to and from the wheels is the drivetrain's while the car drives, and
the brakes' while it brakes: friction and drivetrain together, for no signal tells them apart.
Beside that stand heating and cooling, and all other standing load.
"""

from __future__ import annotations

from enum import IntEnum
import math

import numpy as np

from evpinn_ros.estimation.car_state import SIZE, State
from evpinn_ros.estimation.weak_form import (
    CLIMATE,
    STANDING,
    Constants,
    Warmth,
    Wheels,
    by_motor,
    rolling_gradient,
    standing,
    wheels_at,
)
from evpinn_ros.signals.interval import Steps
from evpinn_ros.signals.road import Conditions
from evpinn_ros.vehicle.linear_power import turning


class Part(IntEnum):
    """Index of a part. All but the last add up to the whole."""

    AIR = 0
    TYRES = 1
    SLOPE = 2  # net
    SPEED = 3  # net: what is in the motion of the car at the end
    BRAKES = 4  # lost while braking, in brakes and drivetrain
    DRIVETRAIN = 5  # lost while driving, and by turning
    CLIMATE = 6
    STANDING = 7
    REGAINED = 8  # by braking, at the battery: beside the sum, for it is what was not lost


COUNT = len(Part)
WHOLE = slice(0, Part.REGAINED)  # the parts that add up
ALONG = [State.C_RR, State.ROLL_COLD, State.ROLL_DRIVE, State.ROLL_START]


def parts(
    mean: np.ndarray, steps: Steps, conditions: Conditions, warmth: Warmth, car: Constants
) -> tuple[np.ndarray, np.ndarray]:
    """Energy of each part, J, shape (COUNT,), and its gradient, shape (COUNT, SIZE).

    Args:
        mean: states, shape (SIZE,).
        steps: n of an interval.
        conditions: of the interval.
        warmth: of tyres and cabin.
        car: constants.
    """
    states = mean[None]
    wheels = wheels_at(states, steps, conditions, warmth, car)
    # Wheel energy of all steps, of those that drive, and of what recuperation can take.
    weights = np.ones((3, len(steps.duration)))
    weights[1], weights[2] = wheels.driving, wheels.fade * ~wheels.driving
    by = np.zeros((3, SIZE))
    by[:, State.C_D] = weights @ wheels.drag[0]
    sums = weights @ wheels.total[0]
    by[:, State.MASS] = sums - by[:, State.C_D]
    rolling_gradient(by, states, weights * wheels.weight, steps, conditions, warmth, car)

    energy, gradient = np.zeros(COUNT), np.zeros((COUNT, SIZE))
    _at_wheels(energy, gradient, mean, by[0], wheels, steps, car)
    if not steps.motor_known:
        eta, mu = math.exp(mean[State.ETA]), math.exp(mean[State.MU])
        drive, back = sums[1] / eta, -mu * sums[2]
        gradient[Part.DRIVETRAIN], gradient[Part.REGAINED] = by[1] / eta, -mu * by[2]
        gradient[Part.DRIVETRAIN, State.ETA] = -drive
        gradient[Part.REGAINED, State.MU] = back
    else:
        by_torque = np.zeros((1, SIZE))
        drive, brake = by_motor(states, steps, by_torque)[0]
        back = -brake
        gradient[Part.DRIVETRAIN, [State.TORQUE, State.ETA]] = by_torque[0, State.TORQUE]
        gradient[Part.REGAINED, State.GENERATOR] = -by_torque[0, State.GENERATOR]
    energy[Part.DRIVETRAIN], energy[Part.REGAINED] = drive, back
    _losses(energy, gradient, mean, wheels, steps)
    energy[Part.DRIVETRAIN] -= sums[1]
    gradient[Part.DRIVETRAIN] -= by[1]
    # What braking offers and what comes back of it leave what is lost.
    energy[Part.BRAKES] = sums[1] - sums[0] - energy[Part.REGAINED]
    gradient[Part.BRAKES] = by[1] - by[0] - gradient[Part.REGAINED]
    _beside(energy, gradient, mean, steps, conditions, warmth)
    return energy, gradient


def _at_wheels(
    energy: np.ndarray,
    gradient: np.ndarray,
    mean: np.ndarray,
    whole: np.ndarray,
    wheels: Wheels,
    steps: Steps,
    car: Constants,
) -> None:
    """Fill in air, tyres, slope and speed from the gradient of all wheel energy."""
    mass = math.exp(mean[State.MASS])
    weight = float(wheels.weight[0, 0])
    force = float(whole[State.FORCE] * mean[State.FORCE])
    energy[Part.AIR] = whole[State.C_D] + force
    energy[Part.SLOPE] = weight * steps.climb.sum() + whole[State.CLIMB] * mean[State.CLIMB]
    energy[Part.SPEED] = mass * car.rotating_mass_factor * steps.kinetic.sum()
    energy[Part.TYRES] = whole[State.MASS] - force - energy[Part.SLOPE] - energy[Part.SPEED]
    gradient[Part.AIR, [State.C_D, State.FORCE]] = whole[[State.C_D, State.FORCE]]
    gradient[Part.AIR, State.MASS] = force
    gradient[Part.SLOPE, State.CLIMB] = whole[State.CLIMB]
    gradient[Part.TYRES, ALONG] = whole[ALONG]
    for part in (Part.TYRES, Part.SLOPE, Part.SPEED):
        gradient[part, State.MASS] = energy[part]


def _losses(
    energy: np.ndarray, gradient: np.ndarray, mean: np.ndarray, wheels: Wheels, steps: Steps
) -> None:
    """Add what a drivetrain loses by turning, and by force squared."""
    turned = float(steps.duration @ turning(steps.distance / steps.duration))
    drive, brake = (
        float((wheels.square * where).sum()) for where in (wheels.driving, ~wheels.driving)
    )
    energy[Part.DRIVETRAIN] += mean[State.NO_LOAD] * turned + mean[State.COPPER] * drive
    energy[Part.REGAINED] -= mean[State.COPPER] * brake
    gradient[Part.DRIVETRAIN, State.NO_LOAD] = turned
    gradient[Part.DRIVETRAIN, State.COPPER] = drive
    gradient[Part.REGAINED, State.COPPER] = -brake


def _beside(
    energy: np.ndarray,
    gradient: np.ndarray,
    mean: np.ndarray,
    steps: Steps,
    conditions: Conditions,
    warmth: Warmth,
) -> None:
    """Fill in heating and cooling, and the rest of the standing load."""
    by_load = np.zeros((1, SIZE))
    standing(mean[None], steps, conditions, warmth, by_load)
    gradient[Part.STANDING, STANDING] = by_load[0, STANDING]
    gradient[Part.CLIMATE, CLIMATE] = by_load[0, CLIMATE]
    energy[Part.STANDING] = float(by_load[0, STANDING] @ mean[STANDING])
    reported = conditions.load * float(steps.duration.sum())
    energy[Part.CLIMATE] = float(by_load[0, CLIMATE] @ mean[CLIMATE]) + reported
