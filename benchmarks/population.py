"""Prior of a car that is not known, from the certified ones: `config/vehicles/generic.yaml`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from evpinn_ros.vehicle.certified import DRAG_SPREAD, MASS_SPREAD, ROLLING_SPREAD, CertifiedCar

ANY_MASS = (1300.0, 3200.0)  # kg, with people, within 2 sigma: of a small car, of a large one


class CertifiedDistribution(NamedTuple):
    """Logarithms of mass, kg, c_rr and drag area, m^2: mean, shape (3,), and covariance."""

    mean: np.ndarray
    covariance: np.ndarray


def population(cars: Iterable[CertifiedCar]) -> CertifiedDistribution:
    """Prior for a car that is not known.

    Certified cars are sold in the United States and heavy; small cars weigh half of them. So mass
    is as `ANY_MASS`, and of the certified cars is taken what belongs to a mass: how c_rr and drag
    area go with it, and how they spread at one mass.
    """
    logs = np.array([np.log([load.physics for load in car.loads]).mean(axis=0) for car in cars])
    mean, covariance = logs.mean(axis=0), np.cov(logs.T)
    slope = covariance[0] / covariance[0, 0]  # of each on mass; of mass itself 1
    low, high = np.log(ANY_MASS)
    centre, variance = (low + high) / 2, ((high - low) / 4) ** 2
    wide = covariance + np.outer(slope, slope) * (variance - covariance[0, 0])
    own = np.square((MASS_SPREAD, ROLLING_SPREAD, DRAG_SPREAD))
    return CertifiedDistribution(mean + slope * (centre - mean[0]), wide + np.diag(own))
