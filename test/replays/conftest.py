from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evpinn_ros.core.signals.readings import BatteryReading, Reading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.history import Drive, PowerSeries
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate

URBAN = Path(__file__).parents[2] / "bags" / "urban"


def made(**given: Any) -> Drive:
    """A drive of nothing but what is given."""
    predicted = PowerSeries(*np.empty((4, 0)))
    series = dict.fromkeys(("speed", "measured"), np.empty((0, 2))) | {"energy": np.empty((0, 4))}
    nothing = {"smoothed": predicted, "newest": predicted, "parameters": {}, "final": None}
    return Drive(**{"duration": 60.0, **series, **nothing, **given})


@pytest.fixture(scope="session")
def vehicle():
    return load_vehicle("tesla_model_3_lr")


@pytest.fixture(scope="session")
def readings(vehicle) -> list[Reading]:
    """Two minutes in town, as the car's CAN bus tells them."""
    drive = simulate(DriveKind.URBAN, vehicle, 120.0, seed=11)
    return [r for r in drive.readings if isinstance(r, SpeedReading | BatteryReading)]
