from pathlib import Path
import shutil

import pytest

from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.extras.fleet.car import CarTask
from evpinn_ros.extras.fleet.manifest import CarDrives
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.output import write
from evpinn_ros.replays.simulation.simulate import EPOCH_NS, simulate

pytestmark = pytest.mark.slow

SECONDS = 20.0


@pytest.fixture(scope="session")
def leaf():
    return load_vehicle("nissan_leaf")


@pytest.fixture(scope="session")
def recorded(tmp_path_factory, leaf):
    """Three drives of one car; in order of time they are c, a, b."""
    folder = tmp_path_factory.mktemp("recorded")
    for hour, name in enumerate("cab"):
        start_ns = EPOCH_NS + 3600 * hour * NANOSECONDS
        drive = simulate(DriveKind.URBAN, leaf, SECONDS, 5 + hour, start_ns=start_ns)
        write(drive, folder / name)
    return folder


@pytest.fixture
def drives(recorded, tmp_path):
    """A copy of them, to spoil."""
    return Path(shutil.copytree(recorded, tmp_path / "car", copy_function=shutil.copy2))


@pytest.fixture
def task(tmp_path, leaf):
    """Makes the task of a car with these drives."""

    def make(*paths, vehicle=leaf, folder="out"):
        return CarTask(CarDrives("car", vehicle, paths), tmp_path / folder, tmp_path / "stop")

    return make
