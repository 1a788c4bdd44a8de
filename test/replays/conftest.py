from pathlib import Path

import pytest

from evpinn_ros.core.signals.readings import BatteryReading, Reading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate

URBAN = Path(__file__).parents[2] / "bags" / "urban"


@pytest.fixture(scope="session")
def vehicle():
    return load_vehicle("tesla_model_3_lr")


@pytest.fixture(scope="session")
def readings(vehicle) -> list[Reading]:
    """Two minutes in town, as the car's CAN bus tells them."""
    drive = simulate(DriveKind.URBAN, vehicle, 120.0, seed=11)
    return [r for r in drive.readings if isinstance(r, SpeedReading | BatteryReading)]
