import math

import numpy as np
import pytest

from evpinn_ros.signals.motor import NOMINAL_RATIO, MotorTrack
from evpinn_ros.signals.readings import NANOSECONDS, MotorReading


def at(second: float) -> int:
    return round(second * NANOSECONDS)


def torque(t):
    return 100.0 * np.sin(t)


def test_energy_of_driving_and_braking_stand_apart():
    """A torque that changes its sign, at 200 rad/s: 2 s of either sign, 100 N m at most."""
    found = MotorTrack(2.5, math.nan)
    for t in np.arange(0.0, 2 * math.pi + 0.02, 0.01).tolist():
        found.add(MotorReading(at(t), float(torque(t)), 200.0), math.nan)
    drive, brake = found.energy(at(0.0), at(2 * math.pi))
    assert drive == pytest.approx(200.0 * 200.0, rel=1e-4)
    assert brake == pytest.approx(200.0 * 200.0, rel=1e-4)
    assert found.energy(at(0.0), at(math.pi))[1] == pytest.approx(0.0, abs=1.0)


@pytest.mark.parametrize(("ratio", "taken"), [(27.0, 27.0), (math.nan, NOMINAL_RATIO)])
def test_turning_comes_from_the_car_where_the_motor_is_silent(ratio, taken):
    found = MotorTrack(2.5, ratio)
    for t in (0.0, 0.5, 1.0):
        found.add(MotorReading(at(t), 100.0), 15.0)
    assert found.scaled != math.isnan(ratio)
    assert found.at(at(0.7)) == pytest.approx(100.0 * taken * 15.0)


def test_the_last_reading_holds_for_a_while_and_no_longer():
    found = MotorTrack(2.5, math.nan)
    found.add(MotorReading(at(0.0), 50.0, 100.0), math.nan)
    assert found.at(at(2.0)) == 5000.0 and math.isnan(found.at(at(3.0)))
    assert math.isnan(found.at(at(-1.0)))
    assert all(map(math.isnan, found.energy(at(0.0), at(1.0))))
