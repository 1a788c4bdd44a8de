"""Cars that are exactly what the model believes a car to be, so that errors are the learner's."""

from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache
import math

import numpy as np
import pytest

from evpinn_ros.core.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.core.estimation.estimator import EstimatorSettings, Mode, OnlineEstimator
from evpinn_ros.core.estimation.posterior import interval_terms
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.interval import Interval, Steps
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.core.signals.road import Conditions
from evpinn_ros.core.signals.sample import Sample
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.core.vehicle.identifiable import identifiable
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.replays.simulation.drive import SAMPLE_RATE, DriveKind, drive_speed
from evpinn_ros.replays.simulation.simulate import SimulatedDrive, simulate
from test.combined import combined_power

START = 1_700_000_000 * NANOSECONDS
RATE = 5  # Hz of the synthetic samples


@dataclass(frozen=True)
class Synthetic:
    """Samples of a drive and the power, W, of a car with known parameters, noise included."""

    truth: Parameters
    samples: list[Sample]
    powers: list[float]


@cache
def _speed(kind: DriveKind, seconds: float, seed: int) -> np.ndarray:
    """Speed of a drive at SAMPLE_RATE."""
    return drive_speed(kind, seconds, np.random.default_rng(seed))


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return load_vehicle("tesla_model_3_lr")


@pytest.fixture(scope="session")
def synthetic(vehicle) -> Callable[..., Synthetic]:
    """A drive in town of a car that obeys eq. 19 to the letter, on a road that may have hills."""

    def make(truth, *, seconds=120.0, noise=1.0, hills=1.0) -> Synthetic:
        every = SAMPLE_RATE // RATE
        whole = _speed(DriveKind.URBAN, seconds, 0)
        speed, acceleration = (x[every::every] for x in (whole, np.gradient(whole) * SAMPLE_RATE))
        rng = np.random.default_rng(0)
        white = np.convolve(rng.standard_normal(speed.size + 4), np.full(5, 5**-0.5), "valid")
        slope = hills * 0.006 * np.sin(np.cumsum(speed) / RATE / 60.0)
        powers = combined_power(
            speed,
            acceleration,
            identifiable(truth, vehicle.frontal_area),
            air_density=vehicle.air_density,
            grade=slope,
            rotating_mass_factor=vehicle.rotating_mass_factor,
        )
        powers = powers + noise * np.hypot(60.0, 60.0 * speed) * white
        stamps = [START + k * NANOSECONDS // RATE for k in range(speed.size)]
        rows = zip(stamps, speed.tolist(), acceleration.tolist(), strict=True)
        samples = [Sample(*row, 0.0, vehicle.air_density, 0.0) for row in rows]
        return Synthetic(truth, samples, powers.tolist())

    return make


def _conditions(**others) -> Conditions:
    values = {"air_density": 1.17, "head_wind": 0.0, "celsius": None, "load": 0.0}
    return Conditions(**{**values, "load_known": False, **others})


@pytest.fixture(scope="session")
def conditions() -> Callable[..., Conditions]:
    """A mild day without wind or reported loads, but for what is named."""
    return _conditions


@pytest.fixture(scope="session")
def intervals() -> Callable[..., list[Interval]]:
    """Intervals of 6 s of a speed at SAMPLE_RATE, or a kind of drive, their energy not measured.

    `height` gives the height of the road, m, by the odometer, m.
    """

    def cut(speed, *, height=None, begin_ns=START, **surroundings) -> list[Interval]:
        if isinstance(speed, tuple):
            speed = _speed(*speed)
        middle = (speed[1:] + speed[:-1]) / 2
        odometer, air = (
            np.concatenate(([0.0], np.cumsum(rate / SAMPLE_RATE))) for rate in (middle, middle**3)
        )
        edges = np.arange(0, len(speed), SAMPLE_RATE)
        heights = np.zeros(len(edges)) if height is None else height(odometer[edges])
        whole = [
            np.diff(column)
            for column in (edges / SAMPLE_RATE, odometer[edges], air[edges], speed[edges] ** 2 / 2)
        ]
        columns = (*whole, np.diff(heights), *np.full((2, len(edges) - 1), math.nan))
        conditions = _conditions(**surroundings)
        return [
            Interval(
                begin_ns + k * NANOSECONDS,
                begin_ns + (k + 6) * NANOSECONDS,
                Steps(*(column[k : k + 6] for column in columns)),
                conditions,
                height is not None,
                math.nan,
                math.nan,
            )
            for k in range(0, len(edges) - 6, 6)
        ]

    return cut


def measured(equation, drive, noise=0.0, seed=0, **factors) -> list[Interval]:
    """Intervals with the energy of the prior car, some of its states multiplied by a factor."""
    truth, rng = equation.mean.copy(), np.random.default_rng(seed)
    for name, factor in factors.items():
        truth[State[name]] *= factor
    return [
        replace(
            interval,
            energy=float(interval_terms(equation, interval, 0.0).journey.row @ truth)
            + rng.normal(0.0, noise),
            sampling_variance=0.0,
        )
        for interval in drive
    ]


@pytest.fixture(scope="session")
def as_prior(intervals) -> Callable[..., list[Interval]]:
    """Intervals of a kind of drive, with the energy that the prior car takes."""
    return lambda equation, drive: measured(equation, intervals(drive, begin_ns=0))


@cache
def _drive(seed: int, seconds: float) -> SimulatedDrive:
    return simulate(DriveKind.URBAN, load_vehicle("tesla_model_3_lr"), seconds, seed)


@pytest.fixture(scope="session")
def drive() -> Callable[[int, float], SimulatedDrive]:
    """A simulated urban drive by seed and length, s, with all that the filter does not know."""
    return _drive


@pytest.fixture(scope="session")
def new_estimator(vehicle) -> Callable[..., OnlineEstimator]:
    """An estimator of this car with these settings."""

    def make(worker: InlineWorker | None = None, mode=Mode.HYBRID, **settings) -> OnlineEstimator:
        clock = iter(range(10**9)).__next__  # each look at it takes a second
        return OnlineEstimator(
            vehicle, EstimatorSettings(mode=mode, **settings), worker or InlineWorker(clock)
        )

    return make


@pytest.fixture(scope="session")
def taught(vehicle, drive) -> Callable[[float], OnlineEstimator]:
    """A copy of an estimator that has seen so many seconds of the drive of seed 1."""
    readings, kept = drive(1, 240.0).readings, {}

    def up_to(seconds: float) -> OnlineEstimator:
        if seconds not in kept:
            earlier = max((shorter for shorter in kept if shorter < seconds), default=0.0)
            fresh = OnlineEstimator(vehicle, EstimatorSettings(), InlineWorker(lambda: 0.0))
            estimator = deepcopy(kept.get(earlier, fresh))
            first, last = (
                readings[0].stamp_ns + round(until * NANOSECONDS) for until in (earlier, seconds)
            )
            estimator.add_readings(r for r in readings if first <= r.stamp_ns < last)
            kept[seconds] = estimator
        return deepcopy(kept[seconds])

    return up_to


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
    return lambda estimator, readings: estimator.add_readings(readings)


@pytest.fixture
def cruise() -> Callable[..., list[Reading]]:
    """Speed and battery at 10 Hz, the same at every moment, for these seconds."""

    def readings(begin, end, *, speed=15.0, power=6000.0, battery=True) -> list[Reading]:
        def every() -> Iterator[Reading]:
            for tick in range(round(begin * 10), round(end * 10)):
                stamp = START + tick * NANOSECONDS // 10
                yield SpeedReading(stamp, speed)
                if battery:
                    yield BatteryReading(stamp, 400.0, -power / 400.0)

        return list(every())

    return readings
