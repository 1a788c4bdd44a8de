"""The ledger of a simulated drive holds every joule, once."""

import numpy as np
import pytest

from benchmarks.breakdown import part_powers
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import SimulatedDrive, simulate


@pytest.fixture(scope="module", params=DriveKind)
def drive(request) -> SimulatedDrive:
    """A few minutes of every kind of driving."""
    return simulate(request.param, load_vehicle("tesla_model_3_lr"), 240.0, 1)


def test_the_parts_are_the_power_at_every_moment(drive):
    powers = part_powers(drive.car, drive.trace)
    whole = sum(power for name, power in powers.items() if name != "regained")
    assert np.abs(whole - drive.trace.power).max() < 1e-6 * np.abs(drive.trace.power).max()
