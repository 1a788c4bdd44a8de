"""Common distribution of cars of one model: mean and spread of their parameters (empirical Bayes).

Each car's parameters are a draw from N(mean, spread), in logarithms except p_aux. Of each car only
the likelihood counts (`estimation.evidence`). The vehicle file is the prior: half of its variance
is uncertainty of the mean; the other half is the spread between cars, and weighs as much as a
quarter of a car. The spread is estimated by expectation maximisation, with the uncertainty of the
mean included (Dempster, Laird and Rubin, 1977; restricted maximum likelihood).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from evpinn_ros.core.estimation.evidence import LINEAR, NO_EVIDENCE, SIZE, Evidence, file_prior
from evpinn_ros.core.vehicle.files import Vehicle, limits_of
from evpinn_ros.core.vehicle.identifiable import POWERS
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES, Prior

FILE_SHARE = 0.5  # of the vehicle file's variance for the mean; the rest is spread
FILE_CARS = 0.25  # weight of the file's spread, in cars
MOST_STEPS, PRECISE = 3000, 1e-7  # of the expectation maximisation; of the prior's variance

# Sums of logarithms that data determine.
COMBINATIONS = {
    "mass_over_eta": POWERS["mass_over_eta"],
    "c_d_over_eta": POWERS["drag_area_over_eta"],
    "regeneration": POWERS["regeneration"],
}


@dataclass(frozen=True, slots=True)
class PopulationValue:
    """One parameter or combination of a population, as logarithm except p_aux."""

    mean: float  # of the cars
    mean_std: float  # 1-sigma of the mean
    spread: float  # standard deviation from car to car
    spread_std: float  # 1-sigma of the spread
    cars: float  # number of fully known cars that would determine the spread as well

    @property
    def new_car_std(self) -> float:
        """1-sigma of a new car: the spread, and the uncertainty of the mean."""
        return math.hypot(self.spread, self.mean_std)


class Population:
    """Mean and spread of the cars of one model, from the evidence of each."""

    def __init__(self, vehicle: Vehicle, evidence: Sequence[Evidence]) -> None:
        self.vehicle = vehicle
        evidence = [car for car in evidence if car.precision.any()]
        precision = np.array([car.precision for car in evidence]).reshape(-1, SIZE, SIZE)
        information = np.array([car.information for car in evidence]).reshape(-1, SIZE)
        self._prior, self._scale = file_prior(vehicle)
        self._spread = _spread(precision, information)
        weight = _weight(precision, self._spread)
        self._mean, self._doubt = _mean(precision, information, weight)
        self._root = np.linalg.cholesky(self._spread)
        self._spread_doubt = _spread_doubt(self._root.T @ weight @ precision @ self._root)

    def value(self, name: str) -> PopulationValue:
        """The value of one of `PARAMETER_NAMES` or `COMBINATIONS`."""
        return self._along(_direction(name))

    def of_file(self, name: str) -> tuple[float, float]:
        """Mean and 1-sigma of a parameter or combination by the vehicle file."""
        return self.of_car(name, NO_EVIDENCE)

    def of_car(self, name: str, car: Evidence) -> tuple[float, float]:
        """Mean and 1-sigma for one car, from the vehicle file and the car's evidence."""
        direction = _direction(name)
        scaled = direction * self._scale
        doubt = np.linalg.inv(np.eye(SIZE) + car.precision)
        mean = direction @ self._prior + scaled @ doubt @ car.information
        return float(mean), math.sqrt(scaled @ doubt @ scaled)

    def covariance(self) -> np.ndarray:
        """Covariance between cars of the logarithms and of p_aux, shape (6, 6)."""
        return self._spread * np.outer(self._scale, self._scale)

    def priors(self, source: str) -> Vehicle:
        """The vehicle with priors for the next car of this model."""
        priors = {name: self._new_prior(name, source) for name in PARAMETER_NAMES}
        return replace(self.vehicle, priors=priors, correlations={}, paper_start={})

    def _new_prior(self, name: str, source: str) -> Prior:
        shared = self.value(name)
        limits = limits_of(name, self.vehicle.relative_size)
        value = shared.mean if name == LINEAR else math.exp(shared.mean)
        value = min(max(value, limits.lower), limits.upper)
        std = shared.new_car_std * (1.0 if name == LINEAR else value)
        return Prior(value, std, f"{source}: worth {shared.cars:.1f} cars")

    def _along(self, direction: np.ndarray) -> PopulationValue:
        """Estimate of a linear combination of parameters with weights `direction`, shape (6,)."""
        scaled = direction * self._scale
        spreads = scaled @ self._root
        variance = float(spreads @ spreads)
        square = np.kron(spreads, spreads)
        doubt = float(square @ self._spread_doubt @ square)
        spread = math.sqrt(variance)
        return PopulationValue(
            mean=float(direction @ self._prior + scaled @ self._mean),
            mean_std=math.sqrt(float(scaled @ self._doubt @ scaled)),
            spread=spread,
            spread_std=math.sqrt(doubt) / (2.0 * spread),
            cars=max(0.0, 2.0 * variance**2 / doubt - FILE_CARS),
        )


def _direction(name: str) -> np.ndarray:
    """Direction of a parameter or a combination, shape (6,)."""
    parts = COMBINATIONS.get(name, {name: 1.0})
    return np.array([parts.get(parameter, 0.0) for parameter in PARAMETER_NAMES])


def _weight(precision: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Weight (1 + precision spread)^-1 of each car, shape (n, 6, 6)."""
    return np.linalg.inv(np.eye(SIZE) + precision @ spread)


def _mean(
    precision: np.ndarray, information: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    doubt = np.linalg.inv(np.eye(SIZE) / FILE_SHARE + (weight @ precision).sum(axis=0))
    return doubt @ np.einsum("nij,nj->i", weight, information), (doubt + doubt.T) / 2


def _spread_doubt(informed: np.ndarray) -> np.ndarray:
    """Covariance of the spread's elements, shape (36, 36): inverse Fisher information.

    `informed` is (spread + precision^-1)^-1 of each car, shape (n, 6, 6), in units of the spread.
    """
    flat = informed.reshape(-1, SIZE**2)
    information = (flat.T @ flat).reshape((SIZE,) * 4).transpose(0, 2, 1, 3)
    information = information.reshape(SIZE**2, SIZE**2) + FILE_CARS * np.eye(SIZE**2)
    return np.asarray(np.linalg.inv(information / 2.0))


def _spread(precision: np.ndarray, information: np.ndarray) -> np.ndarray:
    start = np.eye(SIZE) * (1.0 - FILE_SHARE)
    spread = start
    for _ in range(MOST_STEPS):
        weight = _weight(precision, spread)
        mean, doubt = _mean(precision, information, weight)
        left = spread @ weight
        away = np.einsum("nij,nj->ni", left, information - precision @ mean)
        pulled = left @ precision
        total = left.sum(axis=0) + away.T @ away
        total += (pulled @ doubt @ pulled.transpose(0, 2, 1)).sum(axis=0)
        fresh = (FILE_CARS * start + total) / (FILE_CARS + len(precision))
        fresh = (fresh + fresh.T) / 2
        if np.abs(fresh - spread).max() < PRECISE:
            return np.asarray(fresh)
        spread = fresh
    return spread
