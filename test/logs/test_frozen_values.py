"""What stands still while the car does not is no reading, in a table, a bag and a CAN log."""

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import product
import math
from pathlib import Path
import sys

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from exports import START, Drive, crossed, measured, opened, simulated, table

from evpinn_ros.bags.convert import write_readings
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.logs import write_log
from evpinn_ros.can.profile import load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    SpeedReading,
)
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.source import Source
from evpinn_ros.logs.sources import open_source

VEHICLE = load_vehicle("tesla_model_3_lr")
DRIVE = simulated()
BEGIN, END = 300, 600
STRETCH = slice(BEGIN, END)


def of_table(
    drive: Drive, folder: Path, header: str = "t_s,speed_mps,voltage_v,current_a"
) -> Source:
    def line(t, v, u, i, *_):
        return f"{t:.0f},{v:.3f},{u:.2f},{i:.2f}"

    return opened(folder, table(header, drive, line))


def of_unnamed_table(drive: Drive, folder: Path) -> Source:
    return of_table(drive, folder, "time,Speed (m/s),Battery voltage,Battery current")


def readings(drive: Drive) -> list[SpeedReading | BatteryReading]:
    begin = int(START.timestamp()) * NANOSECONDS
    stamps = [begin + int(time * NANOSECONDS) for time in drive.time]
    rows = zip(stamps, drive.speed, drive.voltage, drive.current, strict=True)
    return [
        reading
        for stamp, v, u, i in rows
        for reading in (SpeedReading(stamp, v), BatteryReading(stamp, u, -i))
        if isinstance(reading, SpeedReading) or not math.isnan(u)
    ]


def of_bag(drive: Drive, folder: Path) -> Source:
    with BagWriter(folder / "drive") as writer:
        write_readings(readings(drive), writer)
    return open_source(folder / "drive", VEHICLE)


def of_can_log(drive: Drive, folder: Path) -> Source:
    encoder = Encoder(load_profile(VEHICLE.can_profile))
    frames = [
        encoder.speed(r) if isinstance(r, SpeedReading) else encoder.battery(r)
        for r in readings(drive)
    ]
    write_log(folder / "drive.log", frames)
    return open_source(folder / "drive.log", VEHICLE)


KINDS = (of_table, of_unnamed_table, of_bag, of_can_log)


def held(signal: str, value: float | None = None) -> Drive:
    """A drive in which a signal keeps a value, or its last one, for five minutes."""
    values = getattr(DRIVE, signal).copy()
    values[STRETCH] = values[BEGIN] if value is None else value
    return replace(DRIVE, **{signal: values})


def one_in(count: int, signal: str) -> Drive:
    values = getattr(DRIVE, signal)
    return replace(DRIVE, **{signal: np.where(np.arange(values.size) % count == 0, values, 0.0)})


@crossed("signal,value", KINDS, [*product(("speed", "current"), (None, 0.0))])
def test_a_signal_that_stands_still_is_not_used_there(tmp_path, kind, signal, value):
    source = kind(held(signal, value), tmp_path)
    inside = list(source.readings())
    stamps = {
        reading.stamp_ns
        for reading in inside
        if isinstance(reading, SpeedReading if signal == "speed" else BatteryReading)
        and not (signal == "current" and math.isnan(reading.current))
    }
    assert len(stamps) == pytest.approx(DRIVE.time.size - (END - BEGIN), abs=2)
    assert source.dropped[f"{signal}_stands_still"] == pytest.approx(END - BEGIN, abs=2)
    (note,) = (note for note in source.notes if "stands still" in note)
    assert f"from {BEGIN} s on for" in note


def frozen(*stretches: slice, digits: int = 4, drive: Drive = DRIVE) -> Drive:
    """A drive in which all signals keep their values in some stretches of time."""
    names = ("speed", "voltage", "current", "odometer", "charge")
    signals = {name: getattr(drive, name).round(digits) for name in names}
    for values in signals.values():
        for stretch in stretches:
            values[stretch] = values[stretch.start]
    return replace(drive, **signals)


LOST = {
    "at the end": [slice(600, 900)],
    "for two minutes": [slice(302, 422)],
    "for twenty seconds": [slice(400, 420)],
    "four times": [slice(begin, begin + 30) for begin in (100, 300, 540, 820)],
}


@crossed("stretches", KINDS, [*LOST])
def test_nothing_is_measured_where_all_signals_stand_still(tmp_path, kind, stretches):
    source = kind(frozen(*LOST[stretches]), tmp_path)
    stamps = [
        sum(isinstance(reading, kind) for reading in source.readings())
        for kind in (SpeedReading, BatteryReading)
    ]
    lost = sum(stretch.stop - stretch.start - 1 for stretch in LOST[stretches])
    assert stamps == pytest.approx([DRIVE.time.size - lost] * 2, abs=2)
    assert f"speed and battery stand still from {LOST[stretches][0].start} s on" in source.notes[0]


BRIDGES = {
    "for three minutes": ((302, 480), 3),
    "for twenty seconds": ((400, 420), 3),
    "of whole amperes and tenths of m/s": ((302, 480), 1),
}


@crossed("bridge", KINDS, [*BRIDGES])
def test_nothing_is_measured_where_all_signals_lie_on_lines(tmp_path, kind, bridge):
    """An exporter fills a hole so, and a car of 1700 kg weighed 120 kg."""
    (first, after), digits = BRIDGES[bridge]
    drive = DRIVE.bridged(first, after)
    drive = replace(drive, speed=drive.speed.round(digits), current=drive.current.round(digits))
    source = kind(drive, tmp_path)
    right = DRIVE.rows(np.r_[: first + 1, after : DRIVE.time.size])
    assert measured(source) == pytest.approx((right.distance, right.energy), rel=0.01)
    note = f"speed and battery lie on straight lines from {first} s on for {after - first - 1} s"
    assert source.notes[0].startswith(note)


@pytest.mark.parametrize("battery", ["voltage_v,current_a", "power_w"])
def test_altitude_is_measured_in_a_hole_that_is_filled(tmp_path, battery):
    first, after = 302, 480
    drive = DRIVE.bridged(first, after)
    power = DRIVE.voltage * DRIVE.current
    power[first:after] = np.linspace(power[first], power[after], after - first, endpoint=False)

    def line(t, v, u, i, *_):
        cells = f"{u:.2f},{i:.2f}" if "voltage" in battery else f"{power[int(t)]:.0f}"
        return f"{t:.0f},{v:.3f},{cells},{200 + 30 * math.sin(t / 50):.1f},{8 + 0.01 * t:.2f}"

    header = f"t_s,speed_mps,{battery},elevation_m,ambient_c"
    source = opened(tmp_path, table(header, drive, line))
    kinds = Counter(type(reading) for reading in source.readings())
    assert kinds[AltitudeReading] == DRIVE.time.size
    assert kinds[SpeedReading] == kinds[BatteryReading] == DRIVE.time.size - (after - first - 1)


COARSE = {
    "whole numbers": frozen(digits=0),
    "a cruise of equal values, twice": frozen(slice(200, 240), slice(600, 640)),
    "values that are polled every 12 s": frozen(*(slice(i, i + 12) for i in range(0, 900, 12))),
}


@pytest.mark.parametrize("name", ["Odometer (km)", "SOC (%)", "Altitude (m)", "Latitude"])
def test_a_steady_cruise_is_measured_where_another_signal_changes(tmp_path, name):
    drive = frozen(slice(302, 362))

    def line(t, v, u, i, *_):
        return f"{t:.0f},{v:.3f},{u:.2f},{i:.2f},{40.0 + 0.01 * t:.2f}"

    source = opened(tmp_path, table(f"t_s,speed_mps,voltage_v,current_a,{name}", drive, line))
    list(source.readings())
    assert source.dropped["both_stand_still"] == 0


@pytest.mark.parametrize("kind", [of_table, of_bag])
@pytest.mark.parametrize("values", COARSE)
def test_values_that_stand_still_time_and_again_are_measured(tmp_path, kind, values):
    drive = COARSE[values]
    if "twice" in values:
        for name in ("speed", "voltage", "current"):
            getattr(drive, name)[600:640] = getattr(drive, name)[200]
    source = kind(drive, tmp_path)
    list(source.readings())
    assert "speed and battery stand still" not in " ".join(source.notes)


@crossed("signal,count", KINDS, [*product(("speed", "current"), (3, 5))])
def test_zeros_between_measurements_are_not_used(tmp_path, kind, signal, count):
    source = kind(one_in(count, signal), tmp_path)
    distance, energy = measured(source)
    assert distance == pytest.approx(DRIVE.distance, rel=0.03)  # stops are lost too
    assert energy == pytest.approx(DRIVE.energy, rel=0.02)
    assert "% of its values are 0, also while" in " ".join(source.notes)


@pytest.mark.parametrize("kind", KINDS)
def test_a_current_in_one_of_a_hundred_rows_is_not_measured_in_the_others(tmp_path, kind):
    source = kind(one_in(100, "current"), tmp_path)
    batteries = [r for r in source.readings() if isinstance(r, BatteryReading)]
    assert sum(math.isfinite(reading.current) for reading in batteries) == 9
    assert any("current stands still at 0 A" in note for note in source.notes)


def test_a_current_beside_power_stands_still_without_a_voltage(tmp_path):
    """A damaged header had no name for the voltage: a KeyError."""

    def line(t, v, u, i, *_):
        return f"{t:.0f},{v:.3f},{u * i:.1f},{20.0 if BEGIN <= t < END else i:.2f}"

    source = opened(tmp_path, table("t_s,speed_mps,power_w,current_a", DRIVE, line))
    assert measured(source)[1] == pytest.approx(DRIVE.energy, rel=0.01)
    assert any(f"current stands still at 20 A from {BEGIN} s" in note for note in source.notes)


CHANGES = {
    "right": (lambda amperes: amperes, None),
    "zero": (np.zeros_like, "current is always 0 A while the car speeds up"),
    "turned": (
        np.negative,
        "the car speeds up while its battery is charged: the sign of the current",
    ),
    "unsigned": (np.abs, "the harder the car brakes, the more the battery seems to give"),
    "one way": (lambda amperes: np.maximum(amperes, 0.0), "no current ever flows back into"),
}


@pytest.mark.parametrize("kind", [of_bag, of_can_log])
@pytest.mark.parametrize("change", CHANGES)
def test_what_the_battery_cannot_be_is_said(tmp_path, kind, change):
    """The log is read all the same; its battery is heard half a minute later than its speed."""
    changed, note = CHANGES[change]
    voltage = np.where(DRIVE.time < 30.0, math.nan, DRIVE.voltage)
    source = kind(replace(DRIVE, voltage=voltage, current=changed(DRIVE.current)), tmp_path)
    currents = [r.current for r in source.readings() if isinstance(r, BatteryReading)]
    assert len(currents) == DRIVE.time.size - 30
    assert all(map(math.isnan, currents)) == (change == "zero")
    assert [text.startswith(note or "") for text in source.notes] == [True] * (note is not None)


@pytest.mark.parametrize("way", ["odometer", "places"])
@pytest.mark.parametrize("value", [None, 0.0])
def test_the_way_shows_that_a_speed_stands_still(tmp_path, way, value):
    """Without a battery that tells anything."""
    silent = np.ones(DRIVE.time.size)
    drive = replace(held("speed", value), voltage=360.0 * silent, current=7.0 * silent)

    def line(t, v, u, i, far, _):
        place = f"{far / 1000:.2f}" if way == "odometer" else f"{(far - 28e6) / 111_195:.6f},7.1"
        return f"{t:.0f},{3.6 * v:.2f},{u:.1f},{i:.1f},{place}"

    names = "Odometer (km)" if way == "odometer" else "Latitude,Longitude"
    source = opened(
        tmp_path, table(f"time,Speed (km/h),Voltage (V),Current (A),{names}", drive, line)
    )
    stamps = [
        reading.stamp_ns for reading in source.readings() if isinstance(reading, SpeedReading)
    ]
    is_less = way == "places" and value is None  # so the car may have turned round
    assert len(stamps) == pytest.approx(DRIVE.time.size - (0 if is_less else END - BEGIN), abs=2)


@pytest.mark.parametrize("way", ["odometer", "places"])
@pytest.mark.parametrize(("unit", "times"), [(0.44704, "1.6"), (1 / 3.6, "1"), (0.1, "0.36")])
def test_an_odometer_or_places_that_contradict_the_speed_are_told(tmp_path, way, unit, times):
    def line(t, v, u, i, far, _):
        place = f"{far / 1000:.2f}" if way == "odometer" else f"{(far - 28e6) / 111_195:.6f},7.1"
        return f"{t:.0f},{v / unit:.2f},{u:.1f},{i:.1f},{place}"

    names = "Odometer (km)" if way == "odometer" else "Latitude,Longitude"
    source = opened(
        tmp_path, table(f"time,Speed (km/h),Voltage (V),Current (A),{names}", DRIVE, line)
    )
    list(source.readings())
    said = {"odometer": "the odometer counts", "places": "the positions are"}[way]
    assert (f"{said} {times} times" in " ".join(source.notes)) == (times != "1")


STEADY: dict[str, Callable[[], Drive]] = {
    "parked": lambda: replace(DRIVE, speed=np.where(DRIVE.time < 500, 0.0, DRIVE.speed),
                              current=np.where(DRIVE.time < 500, 1.3, DRIVE.current)),
    "charged before": lambda: replace(DRIVE, speed=np.where(DRIVE.time < 300, 0.0, DRIVE.speed),
                              current=np.where(DRIVE.time < 300, -30.0, DRIVE.current)),
    "cruise control on hills": lambda: replace(
        DRIVE,
        speed=np.maximum(DRIVE.speed, np.clip(40.0 - 0.2 * np.abs(DRIVE.time - 300.0), 0.0, 30.0)),
        current=np.where(np.abs(DRIVE.time - 300.0) < 100.0,
                         60.0 + 30.0 * np.sin(DRIVE.time / 25.0), DRIVE.current)),
    "no regeneration": lambda: replace(DRIVE, current=np.maximum(DRIVE.current, 0.0)),
    "whole numbers": lambda: replace(DRIVE, current=DRIVE.current.round(-1)),
}  # fmt: skip


@pytest.mark.parametrize("steady", STEADY)
def test_what_a_car_does_is_measured(tmp_path, steady):
    drive = STEADY[steady]()
    source = of_table(drive, tmp_path)
    assert measured(source) == pytest.approx((drive.distance, drive.energy), rel=0.01)
    assert not any("stand" in note or "zeros" in note for note in source.notes)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("cell", ["1e300", "-1e308", "inf", "nan", "x", "65535"])
@pytest.mark.parametrize("share", [0.1, 1.0])
def test_damaged_cells_of_any_size_are_no_numbers_to_count_with(tmp_path, cell, share):
    chance = np.random.default_rng(0)

    def line(t, v, u, i, far, _):
        numbers = f"{v:.2f}", f"{u:.1f}", f"{i:.2f}", f"{far:.0f}", f"{far / 1e7:.6f}", "7.1"
        cells = [cell if chance.random() < share else number for number in numbers]
        return ",".join([f"{t:.0f}", *cells])

    header = "time,Speed,Voltage,Current,Odometer,Latitude,Longitude"
    source = opened(tmp_path, table(header, DRIVE, line))
    with suppress(InputError):  # there is none
        list(source.readings())
    assert all(isinstance(note, str) for note in source.notes)
