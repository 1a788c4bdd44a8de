"""Bounds of what a car can do, for counted energies and for totals in a file.

Values within the bounds may still be wrong, but one reading adds at most what a car could have
done in its time, and no sum overflows.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

import numpy as np

from evpinn_ros.common.saved_fields import Range, is_within
from evpinn_ros.core.energy.power_model import PowerModel, Weather, even_steps
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.journey import FORCE_NOISE
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.unevenness import (
    DURATIONS,
    MIDDLES,
    MOST_SHARE,
    UNEVEN_STATES,
    Runs,
    Unevenness,
)
from evpinn_ros.core.signals.admission import MAX_POWER

# Lifetimes. The farthest-driven car known, a Volvo P1800, has 5.2e9 m; a lorry takes 7 kJ/m.
MOST_DISTANCE = 1e10  # m
MOST_ENERGY = 1e14  # J
MOST_SECONDS = 1e15  # s; large, because a leaping stamp may give decades of dropout
# Types of saved values.
Joules: TypeAlias = Annotated[float, Range(-MOST_ENERGY, MOST_ENERGY)]
Sigma: TypeAlias = Annotated[float, Range(0.0, MOST_ENERGY, unknown=True)]
Metres: TypeAlias = Annotated[float, Range(0.0, MOST_DISTANCE)]
Seconds: TypeAlias = Annotated[float, Range(-MOST_SECONDS, MOST_SECONDS)]
ROUNDING = 1.0 + 1e-6  # tolerance of sums
MOST_MASS = 1e6  # kg over eta, of a train


def car_is_possible(car: CarModel) -> bool:
    """True if a given car is plausible, so that sums of its powers stay bounded.

    Judged by a fast drive and by standing in the cold: mean and 1-sigma are at most `MAX_POWER`,
    and the mass at most `MOST_MASS`.
    """
    if not is_within(car) or not 0.0 < car.mean[State.MASS_OVER_ETA] <= MOST_MASS:
        return False
    if np.diag(car.covariance).min() < 0.0 or car.unevenness.share > MOST_SHARE:
        return False
    speed, ones = np.array([30.0, 10.0, 0.0]), np.ones(3)
    ride = even_steps(ones, speed, 0.0 * speed)._replace(kinetic=0.5 * speed)
    rows = PowerModel(car).rows(ride, Weather(1.2, -30.0))
    power = rows @ car.mean
    variance = ((rows @ car.covariance) * rows).sum(-1) + car.load_variance
    noise = car.noise.max() * FORCE_NOISE**2 * speed**2
    within = (np.abs(power) <= MAX_POWER).all() and (variance + noise <= MAX_POWER**2).all()
    return bool(within) and _is_possible(car.unevenness, car)


def _is_possible(uneven: Unevenness, car: CarModel) -> bool:
    """True if no leg's uneven speed takes more power than a car has."""
    speed, duration = map(np.ravel, np.meshgrid(MIDDLES, DURATIONS))
    legs = Runs(duration, speed * duration, np.full_like(speed, 1.2))
    power = uneven.rows(car.equation, legs) @ car.mean[UNEVEN_STATES] / duration
    return bool((np.abs(power) <= MAX_POWER).all())
