"""Priors of a car before driving, compared with certificates that were withheld."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.energy_library import read_cycle
from benchmarks.population import CertifiedDistribution, population
from evpinn_ros.energy.forecast import Profiles, forecast
from evpinn_ros.energy.power_model import vehicle_model
from evpinn_ros.energy.quadrature import trapezoid
from evpinn_ros.vehicle.certified import (
    AIR_DENSITY,
    CertifiedCar,
    RoadLoad,
    certified_cars,
)
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.vehicle.physics import GRAVITY

SPEEDS = (10.0, 20.0, 30.0)  # m/s
TOWN_SPEED, TOWN_ERROR = 10.0, 0.03  # m/s; share by which mass and force are known after a drive
CYCLES = ("udds", "hwfet")
CHARGING_LOSS = 0.12  # of the energy at the wall
NINETY = 1.645
PLAIN = np.array([1.0, 0.0, 0.0])
JOULES_PER_WH_KM = 3.6  # J/m

LEARNED = ("mass", "c_rr", "c_d")


class PriorError(NamedTuple):
    """Error of a prior of the force on cars withheld from it, over the certified force."""

    name: str  # whose prior
    speed: float  # m/s
    bias: float  # in the median
    error: float  # its size, in the median
    inside: float  # share of cars within the 90 % interval
    # size of the error in the median once mass and the force at `TOWN_SPEED` are known to
    # `TOWN_ERROR`
    after: float
    after_inside: float  # likewise


class CycleEnergy(NamedTuple):
    """A certified energy beside what is forecast before anything is learned, Wh/km at the wall."""

    vehicle: str
    cycle: str
    certified: float
    forecast: float

    @property
    def error(self) -> float:
        """Over the certified energy."""
        return self.forecast / self.certified - 1.0


def prior_errors(others: Mapping[str, Vehicle]) -> Iterator[PriorError]:
    """The population of the other models, with and without correlations, and given vehicles."""
    cars = certified_cars()
    models = {key: _model(key) for key in cars}
    left_out = {
        model: population(car for key, car in cars.items() if models[key] != model)
        for model in set(models.values())
    }
    priors = [(car, left_out[models[key]]) for key, car in cars.items()]
    yield from _judge("population of the other models", priors)
    alone = [
        (car, CertifiedDistribution(p.mean, np.diag(np.diag(p.covariance)))) for car, p in priors
    ]
    yield from _judge("likewise, without correlations", alone)
    for name, vehicle in others.items():
        yield from _judge(name, [(car, of_vehicle(vehicle)) for car in cars.values()])


def _model(key: str) -> str:
    """Cars that share a body are left out together: make and the first word of the model."""
    return "_".join(key.split("_")[:2])


def of_vehicle(vehicle: Vehicle) -> CertifiedDistribution:
    """A vehicle file's prior of mass, c_rr and drag area."""
    priors = [vehicle.priors[name] for name in LEARNED]
    std = np.array([prior.std / prior.value for prior in priors])
    places = [PARAMETER_NAMES.index(name) for name in LEARNED]
    covariance = np.outer(std, std) * vehicle.correlation[np.ix_(places, places)]
    start = vehicle.initial
    mean = np.log([start.mass, start.c_rr, start.c_d * vehicle.frontal_area])
    return CertifiedDistribution(mean, covariance)


def _judge(
    name: str, priors: Sequence[tuple[CertifiedCar, CertifiedDistribution]]
) -> Iterator[PriorError]:
    for speed in SPEEDS:
        rows = []
        for car, prior in priors:
            mass, c_rr, area = np.exp([np.log(load.physics) for load in car.loads]).mean(axis=0)
            truth = np.log([mass, c_rr, area])
            certain = float(RoadLoad(*np.mean(car.loads, axis=0)).force(np.array(speed)))
            learned = _learn(prior, truth)
            rows.append([*_off(prior, speed, certain), *_off(learned, speed, certain)])
        off, inside, after, after_inside = np.array(rows).T
        yield PriorError(
            name,
            speed,
            float(np.median(off)),
            float(np.median(np.abs(off))),
            float(inside.mean()),
            float(np.median(np.abs(after))),
            float(after_inside.mean()),
        )


def _force(logs: np.ndarray, speed: float) -> tuple[float, np.ndarray]:
    """Logarithm of the force, N, and its gradient by those of mass, c_rr and drag area."""
    mass, c_rr, area = np.exp(logs)
    rolling, drag = mass * c_rr * GRAVITY, 0.5 * AIR_DENSITY * area * speed**2
    force = rolling + drag
    return math.log(force), np.array([rolling, rolling, drag]) / force


def _off(prior: CertifiedDistribution, speed: float, certain: float) -> tuple[float, bool]:
    """Error of the force over the certified one, and whether the interval holds it."""
    force, gradient = _force(prior.mean, speed)
    away = force - math.log(certain)
    sigma = math.sqrt(gradient @ prior.covariance @ gradient)
    return math.expm1(away), abs(away) < NINETY * sigma


def _learn(prior: CertifiedDistribution, truth: np.ndarray) -> CertifiedDistribution:
    """Posterior once mass and the force at `TOWN_SPEED` are known: Gauss-Newton to the mode."""
    measured = np.array([truth[0], _force(truth, TOWN_SPEED)[0]])
    mean = prior.mean
    for _ in range(5):
        force, gradient = _force(mean, TOWN_SPEED)
        rows = np.array([PLAIN, gradient])
        left = measured - np.array([mean[0], force]) - rows @ (prior.mean - mean)
        seen = rows @ prior.covariance @ rows.T + TOWN_ERROR**2 * np.eye(2)
        gain = prior.covariance @ rows.T @ np.linalg.inv(seen)
        mean = prior.mean + gain @ left
    return CertifiedDistribution(mean, prior.covariance - gain @ rows @ prior.covariance)


def cycle_energies(folder: Path, car: CertifiedCar, vehicle: Vehicle) -> Iterator[CycleEnergy]:
    """Certified cycles of a car, forecast by the priors of a vehicle.

    Raises:
        InputError: a cycle is missing.
    """
    model = vehicle_model(vehicle)
    for name, certified in zip(CYCLES, (car.udds, car.highway), strict=True):
        if math.isnan(certified):
            continue
        time_s, speed = read_cycle(folder / f"{name}.csv")
        profile = Profiles(time_s, speed[None])
        energy = forecast(profile, vehicle, model, air_density=AIR_DENSITY).energy[0]
        each = float(energy) / trapezoid(speed, time_s) / JOULES_PER_WH_KM
        yield CycleEnergy(vehicle.key, name, certified, each / (1.0 - CHARGING_LOSS))
