from pathlib import Path

import pytest

from evpinn_ros.signals.readings import BatteryReading, Reading, SpeedReading
from evpinn_ros.simulation.drive import DriveKind
from evpinn_ros.simulation.simulate import simulate
from evpinn_ros.vehicle.files import load_vehicle

URBAN = Path(__file__).parents[2] / "bags" / "urban"


@pytest.fixture(scope="session")
def vehicle():
    return load_vehicle("tesla_model_3_lr")


@pytest.fixture(scope="session")
def readings(vehicle) -> list[Reading]:
    """Two minutes in town, as the car's CAN bus tells them."""
    drive = simulate(DriveKind.URBAN, vehicle, 120.0, seed=11)
    return [r for r in drive.readings if isinstance(r, SpeedReading | BatteryReading)]
