"""A car that is exactly what the filter believes a car to be, so that errors are the filter's."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
import math

import numpy as np
import pytest

from evpinn_ros.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.estimation.parameter_filter import (
    CORRELATION_TIME,
    FORCE_NOISE,
    POWER_NOISE,
    SLOPE_LENGTH,
    SLOPE_STD,
)
from evpinn_ros.estimation.worker import InlineWorker, Worker
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.signals.sample import Sample
from evpinn_ros.simulation.drive import SAMPLE_RATE, DriveKind, drive_speed
from evpinn_ros.simulation.simulate import SimulatedDrive, simulate
from evpinn_ros.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.vehicle.identifiable import combined_power, identifiable
from evpinn_ros.vehicle.parameters import Parameters

START = 1_700_000_000 * NANOSECONDS
RATE = 5  # Hz of the synthetic samples


@dataclass(frozen=True)
class Synthetic:
    """Samples of a drive and the power, W, of a car with known parameters, noise included."""

    truth: Parameters
    samples: list[Sample]
    powers: list[float]


@cache
def _motion(seconds: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Speed and acceleration of an urban drive at RATE."""
    speed = drive_speed(DriveKind.URBAN, seconds, np.random.default_rng(seed))
    every = SAMPLE_RATE // RATE
    return speed[every::every], np.gradient(speed, 1 / SAMPLE_RATE)[every::every]


def _noise(speed: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """As the filter believes: relative to speed, and one independent value each 0.5 s.

    A first-order process whose mean over n samples has (1 + r) / (1 - r) times the variance of
    white noise counts a sample for RATE * CORRELATION_TIME less.
    """
    fewer = RATE * CORRELATION_TIME
    keep = (fewer - 1) / (fewer + 1)
    white = rng.standard_normal(speed.size)
    for k in range(1, speed.size):
        white[k] = keep * white[k - 1] + math.sqrt(1 - keep**2) * white[k]
    return np.hypot(POWER_NOISE, FORCE_NOISE * speed) * white


def _slope(speed: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """As the filter believes: unknown slope that is forgotten over SLOPE_LENGTH."""
    slope = SLOPE_STD * rng.standard_normal(speed.size)
    for k in range(1, speed.size):
        keep = math.exp(-speed[k] / RATE / SLOPE_LENGTH)
        slope[k] = keep * slope[k - 1] + math.sqrt(1 - keep**2) * slope[k]
    return slope


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return load_vehicle("tesla_model_3_lr")


@pytest.fixture(scope="session")
def synthetic(vehicle) -> Callable[..., Synthetic]:
    """A drive of a car that obeys the filter's equations to the letter."""

    def make(truth, *, seconds=120.0, route=0, seed=0, noise=1.0, hills=1.0) -> Synthetic:
        speed, acceleration = _motion(seconds, route)
        rng = np.random.default_rng(seed)
        slope = hills * _slope(speed, rng)
        powers = combined_power(
            speed,
            acceleration,
            identifiable(truth, vehicle.frontal_area),
            air_density=vehicle.air_density,
            grade=slope,
            rotating_mass_factor=vehicle.rotating_mass_factor,
        )
        powers = powers + noise * _noise(speed, rng)
        stamps = [START + k * NANOSECONDS // RATE for k in range(speed.size)]
        rows = zip(stamps, speed.tolist(), acceleration.tolist(), strict=True)
        samples = [Sample(*row, 0.0, vehicle.air_density, 0.0) for row in rows]
        return Synthetic(truth, samples, powers.tolist())

    return make


@cache
def _drive(seed: int, seconds: float) -> SimulatedDrive:
    return simulate(DriveKind.URBAN, load_vehicle("tesla_model_3_lr"), seconds, seed)


@pytest.fixture(scope="session")
def drive() -> Callable[[int, float], SimulatedDrive]:
    """A simulated urban drive by seed and length, s, with all that the filter does not know."""
    return _drive


@pytest.fixture
def new_estimator(vehicle) -> Callable[..., OnlineEstimator]:
    """An estimator of this car with these settings."""

    def make(worker: Worker | None = None, **settings) -> OnlineEstimator:
        clock = iter(range(10**9)).__next__  # each look at it takes a second
        return OnlineEstimator(
            vehicle, EstimatorSettings(**settings), worker or InlineWorker(clock)
        )

    return make


@pytest.fixture
def powers() -> Callable[..., list[PowerEstimate]]:
    """The power estimates among outputs, of these kinds (all but measurements when none)."""

    def select(outputs, *kinds) -> list[PowerEstimate]:
        kinds = kinds or (PowerKind.PREDICTED, PowerKind.SMOOTHED)
        return [o for o in outputs if isinstance(o, PowerEstimate) and o.kind in kinds]

    return select


@pytest.fixture
def play() -> Callable[..., list]:
    """Everything an estimator says of readings."""
    return lambda estimator, readings: [o for r in readings for o in estimator.push(r)]


@pytest.fixture
def cruise() -> Callable[..., list[Reading]]:
    """Speed and battery at 10 Hz, the same at every moment, for these seconds."""

    def readings(begin, end, *, speed=15.0, power=6000.0, battery=True) -> list[Reading]:
        found: list[Reading] = []
        for tick in range(round(begin * 10), round(end * 10)):
            stamp = START + tick * NANOSECONDS // 10
            found.append(SpeedReading(stamp, speed))
            if battery:
                found.append(BatteryReading(stamp, 400.0, -power / 400.0))
        return found

    return readings
