"""Whether the filter's intervals are true: cars that are exactly what it believes a car to be.

Each car is drawn from the priors of its vehicle file and obeys the filter's own equations, with
noise and slopes as the filter has them, so whatever the intervals miss is the filter's fault and
no model's. What real cars have beyond that, `bench.truth` tells.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache
import math

import numpy as np

from evpinn_ros.bench.truth import Comparison
from evpinn_ros.estimation.parameter_filter import (
    CORRELATION_TIME,
    ETA,
    MU,
    P_AUX,
    SLOPE,
    SLOPE_LENGTH,
)
from evpinn_ros.estimation.published_filter import PublishedFilter
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample
from evpinn_ros.simulation.drive import SAMPLE_RATE, DriveKind, drive_speed
from evpinn_ros.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.vehicle.physics import STANDSTILL_SPEED

RATE = 5  # Hz of the samples
SECONDS = 120  # of driving
ROUTES = 20  # different drives, which the cars share
START_NS = 1_735_689_600 * NANOSECONDS


def filter_alone(vehicles: Sequence[str], seeds: Iterable[int]) -> Iterator[Comparison]:
    """Drive one car per seed for `SECONDS` and hold the five parameters against its own."""
    for number, seed in enumerate(seeds):
        vehicle = load_vehicle(vehicles[number % len(vehicles)])
        rng = np.random.default_rng(seed)
        car, learner = _drawn(vehicle, rng), PublishedFilter(vehicle)
        for sample, power in _drive(car, seed % ROUTES, rng):
            learner.advance(sample)
            learner.update(sample, power, 1 / RATE)
            if sample.speed > STANDSTILL_SPEED:
                car.count(sample, power, 1 / RATE)
        found, true = learner.published(), car.published().parameters()
        value, std, share = found.parameters(), found.parameter_std(), found.prior_share()
        for name in PARAMETER_NAMES[:P_AUX]:
            parts = (getattr(part, name) for part in (value, std, share, true))
            yield Comparison(vehicle.key, seed, SECONDS, name, *parts)


def _drawn(vehicle: Vehicle, rng: np.random.Generator) -> PublishedFilter:
    """A filter that knows its car: its state drawn from the priors, eta and mu at most 1."""
    car = PublishedFilter(vehicle)
    while True:
        car.mean = rng.multivariate_normal(car.mean, car.covariance)
        if (car.mean[[ETA, MU]] <= 0.0).all():
            return car
        car = PublishedFilter(vehicle)


def _drive(
    car: PublishedFilter, route: int, rng: np.random.Generator
) -> Iterator[tuple[Sample, float]]:
    """Samples and power, W, with noise and slopes as the filter believes them to be.

    A first-order process whose mean over n values has (1 + r) / (1 - r) times the variance of
    white noise counts a sample for `RATE * CORRELATION_TIME` less, as the filter does.
    """
    fewer = RATE * CORRELATION_TIME
    keep_noise = (fewer - 1) / (fewer + 1)
    slope_std = math.sqrt(car.covariance[SLOPE, SLOPE])
    noise, slope = rng.standard_normal(2)
    for k, (speed, acceleration) in enumerate(_motion(route)):
        keep = math.exp(-speed / RATE / SLOPE_LENGTH)
        fresh = rng.standard_normal(2)
        noise = keep_noise * noise + math.sqrt(1 - keep_noise**2) * fresh[0]
        slope = keep * slope + math.sqrt(1 - keep**2) * fresh[1]
        stamp_ns = START_NS + k * NANOSECONDS // RATE
        sample = Sample(stamp_ns, speed, acceleration, 0.0, car.air_density, 0.0)
        car.mean[SLOPE] = slope_std * slope
        yield sample, car.predict(sample).power + noise * car.residual_std(sample)


@cache
def _motion(route: int) -> list[tuple[float, float]]:
    """Speed, m/s, and acceleration, m/s^2, of a drive in town at `RATE`."""
    speed = drive_speed(DriveKind.URBAN, SECONDS, np.random.default_rng(route))
    every = SAMPLE_RATE // RATE
    acceleration = np.gradient(speed, 1 / SAMPLE_RATE)
    pairs = zip(speed[every::every].tolist(), acceleration[every::every].tolist(), strict=True)
    return list(pairs)
