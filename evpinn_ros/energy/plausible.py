"""Bounds of what a car can do, for what is counted and for totals that a file claims.

Whatever passes them may still be wrong; but one reading then adds at most what a car could have
done in the time that it stands for, and no sum leaves the range of numbers.
"""

from __future__ import annotations

import math
from typing import Annotated, TypeAlias

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.signals.stream import MAX_SPEED
from evpinn_ros.vehicle.linear_power import LinearPower
from evpinn_ros.vehicle.physics import GRAVITY

# More than any road vehicle is charged with, and so than any draws: CharIN's Megawatt Charging
# System ends at 1250 V and 3000 A; the strongest cars drive with 1.6 MW.
MAX_POWER = 4e6  # W
# Lifetimes. The farthest-driven car known, a Volvo P1800, has 5.2e9 m; a lorry takes 7 kJ/m.
MOST_DISTANCE = 1e10  # m
MOST_ENERGY = 1e14  # J
MOST_SECONDS = 1e15  # s; a stamp that leaps may claim decades of dropout, so hardly a bound
# Of a file, in these units.
Joules: TypeAlias = Annotated[float, Range(-MOST_ENERGY, MOST_ENERGY)]
UnknownJoules: TypeAlias = Annotated[float, Range(-MOST_ENERGY, MOST_ENERGY, unknown=True)]
Metres: TypeAlias = Annotated[float, Range(0.0, MOST_DISTANCE)]
Seconds: TypeAlias = Annotated[float, Range(-MOST_SECONDS, MOST_SECONDS)]
# Of a car that is given, from a model of one to a train; time and way in which errors forget
# themselves are not zero.
CAR_RANGES = {
    "drag_area": (0.0, 100.0),
    "rolling_mass": (-1e5, 1e5),
    "mass": (1.0, 1e6),
    "rotating_mass_factor": (1.0, 10.0),
    "standing_noise": (0.0, MAX_POWER),
    "moving_noise": (0.0, MAX_POWER),
    "drift_std": (0.0, MAX_POWER),
    "drift_time": (1e-3, 1e6),
    "slope_force": (0.0, MAX_POWER),
    "slope_length": (1e-3, 1e6),
}
# Features of a fast ride, 30 m/s at 0.5 m/s^2, in the order of `FEATURES`: no coefficient alone
# may take more than `MAX_POWER` there.
_FORCES = 0.5 * 1.2 * 30.0**3, GRAVITY * 30.0, 0.5 * 30.0
FAST_RIDE = np.array([*_FORCES, *_FORCES, 1.0, 1.0, 0.5**2, 1.0])
ROUNDING = 1.0 + 1e-6  # of sums


def speed_is_possible(speed: float) -> bool:
    """True if a speed, m/s, may be counted as distance: the gate of the estimator's stream."""
    return abs(speed) <= MAX_SPEED


def power_is_possible(power: float, sigma: float) -> bool:
    """True if a power and its 1-sigma, W, may be counted; a sigma may be NaN, unknown."""
    return abs(power) <= MAX_POWER and (math.isnan(sigma) or 0.0 <= sigma <= MAX_POWER)


def car_is_possible(car: LinearPower) -> bool:
    """True if a given car is plausible, so that no sum of its powers leaves all bounds."""
    named = ((getattr(car, name), *bounds) for name, bounds in CAR_RANGES.items())
    unsure = np.sqrt((np.clip(car.directions, -1e100, 1e100) ** 2).sum(axis=0))
    most = MAX_POWER / FAST_RIDE
    return all(least <= value <= greatest for value, least, greatest in named) and bool(
        (np.abs(car.mean) <= most).all() and (unsure <= most).all()
    )
