import dataclasses
import itertools
import math

import pytest

from evpinn_ros.can.current_sign import CurrentSign
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate

pytestmark = pytest.mark.slow

SECOND = 10**9


@pytest.fixture(scope="module")
def drive():
    return simulate(DriveKind.URBAN, load_vehicle("tesla_model_3_lr"), 120.0, 4).readings


def flipped(reading):
    if isinstance(reading, BatteryReading):
        return dataclasses.replace(reading, current=-reading.current)
    return reading


def watched(readings):
    sign = CurrentSign()
    for reading in readings:
        sign.add_reading(reading)
    return sign


def test_a_drive_of_the_right_sign(drive):
    sign = watched(drive)
    assert sign.decided and sign.fault is None


def test_a_drive_of_the_wrong_sign(drive):
    sign = watched(map(flipped, drive))
    assert sign.fault.startswith("current_sign: ") and "flip positive_means" in sign.fault


def test_a_hundred_a_second_say_the_same(drive):
    """Each reading ten times over, 10 ms apart, as a whole bus tells them."""
    dense = [
        dataclasses.replace(reading, stamp_ns=reading.stamp_ns + 10_000_000 * copy)
        for reading, copy in itertools.product(map(flipped, drive), range(10))
    ]
    assert watched(sorted(dense, key=lambda reading: reading.stamp_ns)).fault is not None


@pytest.mark.parametrize(("current", "suspected"), [(125.0, False), (-125.0, True)])
def test_fast_charging(current, suspected):
    """50 kW into a standing car whose charge is not told."""
    readings = []
    for index in range(1200):
        stamp = index * SECOND // 10
        readings += [SpeedReading(stamp, 0.0), BatteryReading(stamp, 400.0, current)]
    sign = watched(readings)
    assert sign.decided and (sign.fault is not None) is suspected


@pytest.mark.parametrize(("current", "suspected"), [(30.0, False), (-30.0, True)])
def test_slow_charging_of_a_car_that_is_silent_but_for_its_battery(current, suspected):
    """12 kW for 10 minutes into 60 kWh: 3.3 %."""
    readings = [
        BatteryReading(index * SECOND, 400.0, current, 0.5 + 0.033 * index / 600)
        for index in range(600)
    ]
    sign = watched(readings)
    assert sign.decided and (sign.fault is not None) is suspected


def test_nothing_is_said_of_little_or_of_nonsense(drive):
    assert not watched(drive[:100]).decided
    nonsense = [BatteryReading(index * SECOND, math.nan, math.nan, 0.5) for index in range(100)]
    assert not watched(nonsense).decided
