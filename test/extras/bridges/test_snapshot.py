"""Values that come apart, some only when they change, as readings of one moment."""

import math

import pytest

from evpinn_ros.core.signals.readings import (
    BatteryReading,
    Reading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.extras.bridges.layouts import Measurand, Parsed, Value, read_layout
from evpinn_ros.extras.bridges.snapshot import BURST_NS, Snapshots

SECOND = 1_000_000_000
BASE = "teslamate/cars/1"


class Tesla:
    """Snapshots of a Tesla whose topics come at moments of our choice."""

    def __init__(self):
        self.snapshots, self.layout = Snapshots(360.0, on_change=True), read_layout("teslamate")

    def send(self, at_s, retained=False, **values):
        readings: list[Reading] = []
        for i, (name, value) in enumerate(values.items()):
            parsed = self.layout.parse(f"{BASE}/{name}", str(value).encode())
            moment = round(at_s * SECOND) + i * 1_000_000  # they come within milliseconds
            readings += self.snapshots.add(parsed, moment, retained=retained)
        return readings


@pytest.fixture
def tesla():
    return Tesla()


def test_what_comes_together_is_of_the_moment_of_the_first(tesla):
    assert tesla.send(10, speed=36, power=12) == []
    assert tesla.snapshots.flush(10 * SECOND + BURST_NS - 1) == []
    battery, speed = tesla.snapshots.flush(10 * SECOND + BURST_NS)
    assert battery.stamp_ns == speed.stamp_ns == 10 * SECOND
    assert battery.power == pytest.approx(12_000.0) and battery.voltage == 360.0
    assert speed.speed == pytest.approx(10.0)
    assert speed.variance == pytest.approx((1 / 3.6) ** 2 / 12), "rounded to a km/h"


def test_a_value_that_does_not_come_again_has_not_changed(tesla):
    """Constant power is sent once; the place, which changes, shows that the car still sends."""
    tesla.send(10, speed=36, power=12)
    first = tesla.send(11, latitude=48.1)
    again = tesla.send(12, latitude=48.2)
    assert [type(r) for r in first] == [type(r) for r in again] == [BatteryReading, SpeedReading]
    assert [r.stamp_ns for r in again] == [11 * SECOND] * 2
    assert again[0].power == pytest.approx(12_000.0)


def test_retained_values_are_old_and_not_taken_for_now(tesla):
    tesla.send(10, retained=True, speed=80, power=30, outside_temp=21, usable_battery_level=60)
    assert tesla.snapshots.flush(20 * SECOND) == []
    tesla.send(30, latitude=48.1)
    temperature, battery = tesla.snapshots.flush(31 * SECOND)
    assert isinstance(temperature, TemperatureReading) and temperature.celsius == 21.0
    assert math.isnan(battery.current) and math.isnan(battery.voltage)
    assert battery.state_of_charge == pytest.approx(0.6)


def test_after_a_lost_connection_nothing_fast_holds(tesla):
    tesla.send(10, speed=36, power=12)
    tesla.snapshots.forget()
    assert tesla.snapshots.flush(20 * SECOND) == []
    tesla.send(30, speed=40)
    (speed,) = tesla.snapshots.flush(31 * SECOND)
    assert speed.speed == pytest.approx(40 / 3.6)


def test_a_parked_tesla_stands_whatever_its_last_speed(tesla):
    """TeslaMate sends no speed while there is none: the last one stays, 7 km/h, say."""
    tesla.send(10, speed=7, power=1, shift_state="D")
    tesla.send(12, shift_state="")
    assert tesla.snapshots.flush(13 * SECOND)[-1].speed == 0.0


def test_power_while_charging_is_not_driving(tesla):
    tesla.send(10, speed=0, power=1, usable_battery_level=50, state="driving")
    tesla.send(20, state="charging", power=-7)
    (battery,) = tesla.snapshots.flush(21 * SECOND)
    assert math.isnan(battery.current) and battery.state_of_charge == 0.5
    tesla.send(30, state="driving")
    readings = tesla.snapshots.flush(31 * SECOND)
    assert all(not isinstance(r, SpeedReading) for r in readings), "that of before is not held"


@pytest.mark.parametrize(("ahead_s", "used"), [(3600, True), (1e8, False), (8e9, False)])
def test_a_stamp_of_a_day_that_has_not_come_is_that_of_arrival(ahead_s, used):
    """One of the year 2283 would be the newest for ever, and more ns than 64 bits hold."""
    now_ns = 1_790_000_000 * SECOND
    stamp_ns = now_ns + round(ahead_s * SECOND)
    parsed = Parsed("zoe", {Measurand.SPEED: Value(10.0)}, stamp_ns)
    (speed,) = Snapshots(360.0, on_change=False).add(parsed, now_ns, retained=False)
    assert speed.stamp_ns == (stamp_ns if used else now_ns)
