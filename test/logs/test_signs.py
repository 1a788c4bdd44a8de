"""Signs that are lost, in columns of their own or turned; limits, and signals that say nothing."""

from dataclasses import replace
import itertools
import math
from pathlib import Path
import sys

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from exports import Drive, crossed, date, measured, opened, simulated, table
from test_frozen_values import VEHICLE, of_bag, of_can_log, readings

from evpinn_ros import topics
from evpinn_ros.bags.types import new_message
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import SpeedReading
from evpinn_ros.logs.source import Source
from evpinn_ros.logs.sources import open_source
from evpinn_ros.topics.messages import header
from evpinn_ros.topics.readings import battery_message, speed_message

DRIVE = simulated()
LIGHT = simulated(mass=250.0, volts=48.0)
CHANCE = np.random.default_rng(4)


def of_power(drive: Drive, folder: Path, scale: float = 1e-3) -> Source:
    def line(t, v, u, i, _, soc):
        return f"{date(t)},{3.6 * v:.1f},{scale * u * i:.2f},{soc:.1f}"

    unit = "kW" if scale == 1e-3 else "W"
    return opened(
        folder, table(f"time,Speed (km/h),HV Battery Power ({unit}),SOC (%)", drive, line)
    )


def of_current(drive: Drive, folder: Path) -> Source:
    def line(t, v, u, i, *_):
        return f"{date(t)},{3.6 * v:.2f},{u:.2f},{i:.2f}"

    header = "time,Speed (km/h),HV Battery Voltage (V),HV Battery Current (A)"
    return opened(folder, table(header, drive, line))


KINDS = (of_power, of_current, of_bag, of_can_log)


def doubts(source: Source) -> str:
    list(source.readings())
    return " ".join(source.doubts)


LOST = {
    "a third": CHANCE.random(DRIVE.time.size) < 0.33,
    "one in eight": CHANCE.random(DRIVE.time.size) < 0.125,
    "the second half": DRIVE.time > 450.0,
    "some minutes": (DRIVE.time > 200.0) & (DRIVE.time < 500.0),
}


@crossed("lost", KINDS, [*LOST])
def test_powers_that_lost_their_sign_are_doubted(tmp_path, kind, lost):
    current = np.where(LOST[lost], np.abs(DRIVE.current), DRIVE.current)
    source = kind(replace(DRIVE, current=current), tmp_path)
    assert "they have lost their sign, so every energy is too large" in doubts(source)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("limit", [0.4, 0.7])
def test_a_clipped_current_or_power_is_doubted(tmp_path, kind, limit):
    largest = limit * float(np.max(DRIVE.current))
    voltage = np.full(DRIVE.time.size, 360.0) if kind is of_power else DRIVE.voltage
    drive = replace(DRIVE, voltage=voltage, current=np.minimum(DRIVE.current, largest))
    assert "it seems to be clipped, so every energy is too small" in doubts(kind(drive, tmp_path))


@pytest.mark.parametrize("kind", KINDS[1:])
@pytest.mark.parametrize("volts", [400.0, 350.0])
def test_a_voltage_that_a_large_current_does_not_move_is_doubted(tmp_path, kind, volts):
    drive = replace(DRIVE, voltage=np.full(DRIVE.time.size, volts))
    assert f"the voltage is always {volts:.0f} V while" in doubts(kind(drive, tmp_path))


@crossed("begin,end", KINDS[1:], [(0.0, 200.0), (300.0, 400.0), (500.0, 1e9)])
def test_a_voltage_that_stands_still_for_long_is_doubted(tmp_path, kind, begin, end):
    still = (DRIVE.time >= begin) & (DRIVE.time < end)
    voltage = np.where(still, DRIVE.voltage[still][0], DRIVE.voltage)
    told = doubts(kind(replace(DRIVE, voltage=voltage), tmp_path))
    assert "the voltage stands still at " in told and f" from {begin:.0f} s on" in told


@crossed("lag,seed", KINDS, [*itertools.product((-2.0, 0.0, 1.0, 2.0), (0, 1))])
def test_a_drive_as_it_was_is_not_doubted(tmp_path, kind, lag, seed):
    """Its speed may come late or early."""
    drive = simulated(seed=seed)
    drive = replace(drive, speed=np.interp(drive.time - lag, drive.time, drive.speed))
    assert not doubts(kind(drive, tmp_path))


def test_a_vehicle_of_limited_power_is_not_doubted(tmp_path):
    """It speeds up no harder than its power allows."""
    power = np.minimum(LIGHT.voltage * LIGHT.current, 2500.0)
    speed = [2.0]
    for drawn in power[:-1]:
        gained = (0.88 * drawn if drawn > 0.0 else drawn / 0.6) - speed[-1] * 20.0
        speed.append(float(np.sqrt(max(speed[-1] ** 2 + 2.0 * gained / 250.0, 0.0))))
    drive = replace(LIGHT, speed=np.array(speed), current=power / LIGHT.voltage)
    assert not doubts(of_power(drive, tmp_path, scale=1.0))


PAIRS = {
    "discharge and charging": ("Battery discharge current (A)", "Battery charging current (A)"),
    "drive and recuperation": ("Battery drive current (A)", "Battery recuperation current (A)"),
    "discharge and charge": ("HV Battery Discharge Current (A)", "HV Battery Charge Current (A)"),
    "camels": ("packDischargingCurrent (A)", "packChargingCurrent (A)"),
    "out and in": ("battery_current_out", "battery_current_in"),
}


@pytest.mark.parametrize("names", PAIRS)
@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_charging_current_of_its_own_counts_against_the_other(tmp_path, names, first, sign):
    """Whichever stands first; it may be negative, or 0 while the other flows."""

    def line(t, v, u, i, *_):
        pair = [f"{max(i, 0.0):.2f}", f"{sign * max(-i, 0.0):.2f}"]
        return f"{date(t)},{3.6 * v:.2f},{u:.2f},{pair[first]},{pair[1 - first]}"

    pair = PAIRS[names]
    header = f"time,Speed (km/h),HV Battery Voltage (V),{pair[first]},{pair[1 - first]}"
    source = opened(tmp_path, table(header, DRIVE, line))
    assert measured(source) == pytest.approx((DRIVE.distance, DRIVE.energy), rel=0.01)
    assert f"{pair[1]!r} is assumed to flow back, and is subtracted" in " ".join(source.notes)


@pytest.mark.parametrize(
    "names", ["Battery discharge power (W),Battery charge power (W)", "Power (W),Regen Power (W)"]
)
def test_a_charging_power_of_its_own_counts_too(tmp_path, names):
    def line(t, v, u, i, *_):
        return f"{date(t)},{3.6 * v:.2f},{max(u * i, 0.0):.0f},{max(-u * i, 0.0):.0f}"

    header = f"time,Speed (km/h),{names}"
    source = opened(tmp_path, table(header, DRIVE, line))
    assert measured(source) == pytest.approx((DRIVE.distance, DRIVE.energy), rel=0.01)


@pytest.mark.parametrize(
    ("drawn", "back"),
    [("Discharge Current (A)", "Charge Current (A)"), ("Current (A)", "Regen Current (A)")],
)
def test_a_column_of_both_signs_has_none_that_flows_back(tmp_path, drawn, back):
    def line(t, v, u, i, *_):
        return f"{date(t)},{3.6 * v:.2f},{u:.2f},{i:.2f},{max(-i, 0.0):.2f}"

    header = f"time,Speed (km/h),Voltage (V),{drawn},{back}"
    source = opened(tmp_path, table(header, DRIVE, line))
    assert measured(source)[1] == pytest.approx(DRIVE.energy, rel=0.01)
    assert back in source.ignored


HEADERS = {
    "time (s),Speed (km/h),Voltage (V),Current (A)": 3.6,
    "time,speed,voltage,current": 3.6,
    "t_s,speed_mps,voltage_v,current_a": 1.0,
    "time (s),Speed (mph),Voltage (V),Current (A)": 1 / 0.44704,
}


@pytest.mark.parametrize("header", HEADERS)
def test_the_size_counts_of_speeds_that_are_all_negative(tmp_path, header):
    def line(t, v, u, i, *_):
        return f"{t:.0f},{-HEADERS[header] * v:.2f},{u:.2f},{i:.2f}"

    source = opened(tmp_path, table(header, DRIVE, line))
    assert measured(source) == pytest.approx((DRIVE.distance, DRIVE.energy), rel=0.01)
    assert "speed: all numbers are negative, so their sign is turned" in source.notes
    assert "in -km/h" not in " ".join(source.notes) and "speed:mph" not in " ".join(source.notes)


def test_a_car_may_reverse(tmp_path):
    speed = np.where(DRIVE.time < 90.0, -0.2, 1.0) * DRIVE.speed
    source = of_current(replace(DRIVE, speed=speed), tmp_path)
    assert measured(source)[0] == pytest.approx(np.trapezoid(speed, DRIVE.time), rel=0.01)
    assert "negative" not in " ".join(source.notes)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("drive", [DRIVE, LIGHT], ids=["car", "light"])
def test_a_speed_of_0_while_the_battery_works_is_not_measured(tmp_path, kind, drive):
    if drive is LIGHT and kind is of_can_log:
        pytest.skip("the profile is that of a car")
    source = kind(replace(drive, speed=np.zeros(drive.time.size)), tmp_path)
    try:
        assert np.isnan(measured(source)[0])
    except InputError as error:
        assert "no reading" in str(error)
    assert "speed is always 0 km/h while the battery shows" in " ".join(source.notes)


def bag_of(folder: Path, messages) -> Source:
    """A bag of topics with their messages, both at each second of the drive."""
    with BagWriter(folder / "drive") as writer:
        for reading in readings(DRIVE):
            topic, message = messages(reading)
            writer.write(topic.under("/ev"), message, reading.stamp_ns)
    return open_source(folder / "drive", VEHICLE)


def odometry(reading: SpeedReading, frame: str, heading: float):
    linear = new_message(
        "geometry_msgs/msg/Vector3",
        x=reading.speed * math.cos(heading),
        y=reading.speed * math.sin(heading),
    )
    twist = speed_message(new_message, reading).twist
    twist.twist.linear = linear
    head = header(new_message, reading.stamp_ns, "map")
    return new_message(topics.ODOMETRY_TYPE, header=head, child_frame_id=frame, twist=twist)


@pytest.mark.parametrize(
    ("frame", "turns"), [("map", 1.0), ("map", 0.0), ("base_link", 0.0), ("base_link", 0.01)]
)
def test_odometry_in_the_frame_of_the_map_gives_the_speed_over_ground(tmp_path, frame, turns):
    """The car turns round; in its own frame it slides a little."""

    def messages(reading):
        if isinstance(reading, SpeedReading):
            seconds = (reading.stamp_ns / 1e9) % 900.0
            heading = 0.02 * turns * seconds if frame == "map" else 0.05 * turns
            return topics.ODOMETRY, odometry(reading, frame, heading)
        return topics.BATTERY, battery_message(new_message, reading)

    source = bag_of(tmp_path, messages)
    assert measured(source) == pytest.approx((DRIVE.distance, DRIVE.energy), rel=0.01)
    assert ("magnitude is the speed" in " ".join(source.notes)) == (frame == "map")


@pytest.mark.parametrize("by", ["serial_number", "location", "voltage", "swapped"])
def test_two_batteries_that_take_turns_are_doubted(tmp_path, by):
    count = itertools.count()

    def messages(reading):
        if isinstance(reading, SpeedReading):
            return topics.SPEED, speed_message(new_message, reading)
        number = next(count)
        second = number % 2 if by != "swapped" else int(number > 400)
        if by == "voltage":
            reading = replace(reading, voltage=reading.voltage * (1.0 + 0.2 * second))
        message = battery_message(new_message, reading)
        if by != "voltage":
            setattr(message, "location" if by == "location" else "serial_number", f"B{second}")
        return topics.BATTERY, message

    assert ("take turns" in doubts(bag_of(tmp_path, messages))) == (by != "swapped")


@pytest.mark.parametrize("step", [0.2, 1.0, 2.0])
@pytest.mark.parametrize("shares", [(0.6, 0.2), (0.6, 0.4), (0.5, 0.5)])
@pytest.mark.parametrize("at_once", [True, False])
def test_currents_of_two_batteries_in_turn_are_doubted(tmp_path, shares, step, at_once):
    """Shares of one current, row by row: half and half is a table whose rows repeat."""
    drive = simulated(count=300, step=step)
    moments = range(drive.time.size)
    turns = zip(np.repeat(moments, 2), shares * drive.time.size, strict=True)
    lines = ["time (s),speed (km/h),voltage (V),current (A)"] + [
        f"{drive.time[k]:.1f},{3.6 * drive.speed[k]:.2f},{drive.voltage[k]:.2f},"
        f"{share * drive.current[k]:.3f}"
        for k, share in turns
        if at_once or share == shares[k % 2]  # in rows of their own, or of one moment
    ]
    source = opened(tmp_path, "\n".join(lines))
    assert ("take turns" in doubts(source)) == (shares[0] != shares[1])


AT_REST = {
    "heated": lambda time: 5.0 + 4.0 * (time % 60.0 < 30.0),
    "charged": lambda time: np.where(time < 100.0, 1.0, -30.0 + time / 60.0),
    "an offset": lambda time: 0.05 * np.sin(time),
}


@pytest.mark.parametrize("kind", [of_current, of_bag])
@pytest.mark.parametrize("rest", AT_REST)
def test_a_car_that_stands_has_a_speed_of_0(tmp_path, kind, rest):
    still = np.zeros(DRIVE.time.size)
    source = kind(replace(DRIVE, speed=still, current=AT_REST[rest](DRIVE.time)), tmp_path)
    assert measured(source)[0] == 0.0
