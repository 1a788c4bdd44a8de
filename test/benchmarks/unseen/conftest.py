from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.unseen.drives import UnseenCar, UnseenDrive
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.identifiable import combined_power, identifiable
from evpinn_ros.core.vehicle.parameters import Parameters

pytestmark = pytest.mark.slow

START_NS = 1_700_000_000 * NANOSECONDS
TRUTH = Parameters(eta=0.9, mu=0.8, mass=1950.0, c_rr=0.011, c_d=0.25, p_aux=500.0)


@pytest.fixture(scope="session")
def vehicle():
    return load_vehicle("tesla_model_3_lr")


@pytest.fixture(scope="session")
def true_power(vehicle) -> Callable[[np.ndarray], np.ndarray]:
    """Battery power, W, at times, s, of a car that obeys eq. 21 on a flat road."""
    combined = identifiable(TRUTH, vehicle.frontal_area)

    def power(time: np.ndarray) -> np.ndarray:
        return combined_power(
            speed_at(time),
            (speed_at(time + 1e-3) - speed_at(time - 1e-3)) / 2e-3,
            combined,
            air_density=vehicle.air_density,
            rotating_mass_factor=vehicle.rotating_mass_factor,
        )

    return power


@pytest.fixture(scope="session")
def make_drive(true_power) -> Callable[..., UnseenDrive]:
    """Makes a drive of a length, s, with five readings a second."""

    def make(seconds: float, *, start: float = 0.0) -> UnseenDrive:
        time = start + np.arange(0.0, seconds, 0.2)
        readings: list[Reading] = []
        for t, v, p in zip(time, speed_at(time), true_power(time), strict=True):
            stamp_ns = START_NS + round(t * NANOSECONDS)
            readings.append(SpeedReading(stamp_ns, float(v)))
            readings.append(BatteryReading(stamp_ns, 360.0, -float(p) / 360.0))
        return UnseenDrive(f"drive at {start:g}", tuple(readings))

    return make


@pytest.fixture(scope="session")
def car(vehicle, make_drive) -> UnseenCar:
    """Two drives of ten and five minutes, five readings a second."""
    return UnseenCar("made", vehicle, (make_drive(700.0), make_drive(500.0, start=5000.0)))


def speed_at(time: np.ndarray) -> np.ndarray:
    return 15.0 + 9.0 * np.sin(time / 31.0) + 4.0 * np.sin(time / 7.0)
