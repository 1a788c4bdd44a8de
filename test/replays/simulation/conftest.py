from functools import cache

import pytest

from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import SimulatedDrive, simulate


@cache
def _drive(kind: DriveKind, seed: int) -> SimulatedDrive:
    return simulate(kind, load_vehicle("tesla_model_3_lr"), 240.0, seed)


@pytest.fixture(params=DriveKind)
def drive(request) -> SimulatedDrive:
    """A few minutes of every kind of driving."""
    return _drive(request.param, 1)


@pytest.fixture(scope="session")
def urban() -> SimulatedDrive:
    return _drive(DriveKind.URBAN, 1)
