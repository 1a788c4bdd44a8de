import gzip
import math
from pathlib import Path
import re

import polars as pl
import pytest

from evpinn_ros.core.signals import readings as kinds
from evpinn_ros.core.signals.readings import DRIVE_START_NS, BatteryReading, SpeedReading
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.sources import open_drive
from evpinn_ros.logs.table_drive import TableDrive
from evpinn_ros.logs.terrain import Terrain

DATA = Path(__file__).parents[2].parent / "shared" / "data"
NOMINAL = 350.0
START = DRIVE_START_NS


def drive_of(folder: Path, text: str) -> TableDrive:
    (folder / "drive.csv").write_text(text)
    return open_drive(folder / "drive.csv", NOMINAL)


def test_all_columns(tmp_path):
    drive = drive_of(
        tmp_path,
        "t_s,speed_mps,voltage_v,current_a,power_w,elevation_m,ambient_c,heating_w,aircon_w,soc_pct,"
        "motor_torque_nm,motor_speed_rad_s,latitude,longitude,x\n"
        "0.5,10,400,50,1,570,-3,1500,250,80,-20,270,48.1,11.5,7\n",
    )
    stamp = START + 500_000_000
    expected = [
        SpeedReading(stamp, 10.0),
        BatteryReading(stamp, 400.0, -50.0, 0.8),
        kinds.AltitudeReading(stamp, 570.0, 48.1, 11.5),
        kinds.TemperatureReading(stamp, -3.0),
        kinds.AuxiliaryReading(stamp, 1500.0, 250.0),
        kinds.MotorReading(stamp, -20.0, 270.0),
    ]
    assert list(map(repr, drive.readings())) == list(map(repr, expected))  # NaN is not equal NaN
    assert tuple(drive.ignored) == ("x",) and not drive.dropped


def test_a_torque_needs_no_motor_speed_and_a_speed_alone_is_no_reading(tmp_path):
    header = "t_s,speed_mps,power_w,motor_torque_nm,motor_speed_rad_s\n"
    drive = drive_of(tmp_path, header + "0,1,400,50,\n1,1,400,,300\n")
    (motor,) = (r for r in drive.readings() if isinstance(r, kinds.MotorReading))
    assert repr(motor) == repr(kinds.MotorReading(START, 50.0))


def batteries(drive: TableDrive) -> list[tuple[float, float]]:
    return [(r.voltage, r.current) for r in drive.readings() if isinstance(r, BatteryReading)]


def test_a_state_of_charge_that_is_none_is_left_out(tmp_path):
    lines = [f"{i},1,400,50,{percent}" for i, percent in enumerate((100, 0, "NaN", 101, -1, "?!"))]
    drive = drive_of(tmp_path, "\n".join(["t_s,speed_mps,voltage_v,current_a,soc_pct", *lines]))
    charges = [r.state_of_charge for r in drive.readings() if isinstance(r, BatteryReading)]
    assert charges[:2] == [1.0, 0.0] and len(charges) == 6 and all(map(math.isnan, charges[2:]))
    assert drive.dropped == {"soc_pct_out_of_range": 2, "soc_pct_not_a_number": 1}


def test_power_alone_takes_the_nominal_voltage(tmp_path):
    drive = drive_of(tmp_path, "t_s,speed_mps,power_w\n0,1,7000\n1,1,\n2,1,-3500\n")
    assert batteries(drive) == [(350.0, -20.0), (350.0, 10.0)]
    assert not drive.dropped


def test_each_row_takes_what_it_has(tmp_path):
    drive = drive_of(
        tmp_path,
        "t_s,speed_mps,voltage_v,current_a,power_w\n"
        "0,1,400,50,\n"  # both
        "1,1,,,7000\n"  # power alone: the last measured voltage is better than the nominal one
        "2,1,400,,8000\n"
        "3,1,400,,\n4,1,,50,\n"  # no pair
        "5,1,0,0,\n"  # a sensor that is off
        "6,1,,,\n",
    )
    pairs = [(400.0, -50.0), (400.0, -17.5), (400.0, -20.0), (400.0, math.nan), (math.nan, -50.0)]
    assert list(map(repr, batteries(drive))) == list(map(repr, pairs))
    assert drive.dropped == {"voltage_not_positive": 1} and (drive.rows, drive.used) == (7, 7)


def test_what_is_dropped_is_counted(tmp_path):
    drive = drive_of(
        tmp_path,
        "t_s,speed_mps,power_w,note\n"
        "0,1,1,x\n"
        "1,fast,1,x\n2,slow,inf,x\n"
        "2,1,1,x\n1.5,1,1,x\n"
        ",1,1,x\nsoon,1,1,x\n"
        "3,1\n\n"
        "4,1,1,x\n",
    )
    speeds = [r.stamp_ns - START for r in drive.readings() if isinstance(r, SpeedReading)]
    expected = {
        "speed_mps_not_a_number": 2,
        "power_w_not_a_number": 1,
        "t_s_not_a_number": 1,
        "no_time": 2,
        "wrong_number_of_cells": 1,
    }
    assert speeds == [0, 1_500_000_000, 2_000_000_000, 4_000_000_000] and drive.dropped == expected
    list(drive.readings())
    assert drive.dropped == expected  # a second reading counts anew


def test_time_since_the_epoch_is_kept(tmp_path):
    drive = drive_of(tmp_path, "t_s,speed_mps,power_w\n1700000000.25,1,1\n")
    assert next(drive.readings()).stamp_ns == 1_700_000_000_250_000_000


def test_a_file_that_ends_early_says_where(tmp_path):
    rows = "".join(f"{i},{i % 7},{i * 37 % 101}\n" for i in range(20_000))
    whole = gzip.compress(b"t_s,speed_mps,power_w\n" + rows.encode())
    (tmp_path / "a.csv.gz").write_bytes(whole[: len(whole) // 2])
    drive = open_drive(tmp_path / "a.csv.gz", NOMINAL)
    assert len(list(drive.readings())) > 1000
    assert re.search(r"a.csv.gz:\d+: Compressed file ended", drive.problem)


@pytest.mark.skipif(not DATA.is_dir(), reason="no shared data")
def test_real_drives():
    trip = open_drive(DATA / "bmw_i3" / "TripB11.csv.gz", NOMINAL)
    counts = {}
    for reading in trip.readings():
        counts[type(reading)] = counts.get(type(reading), 0) + 1
    assert len({*counts.values()}) == 1 and len(counts) == 6 and not trip.dropped
    charged = open_drive(DATA / "bmw_i3" / "TripA01.csv.gz", NOMINAL).readings()
    first = next(r for r in charged if isinstance(r, BatteryReading))
    assert first.state_of_charge == pytest.approx(0.869)
    assert "heating_can_w" in trip.ignored and len(trip.rules) + len(trip.ignored) == 15

    tesla = open_drive(DATA / "tesla_model3" / "drive_first_757s.csv", NOMINAL)
    first = next(reading for reading in tesla.readings() if isinstance(reading, BatteryReading))
    assert first.voltage == NOMINAL and first.power == pytest.approx(10142.436)


def test_rows_that_are_late_are_put_in_order_and_one_in_the_future_costs_no_other(tmp_path):
    stamps = [0, 1, 3, 2, 4, 9_999_999, 5, 6, 8, 7, 9]
    rows = "".join(f"{stamp},1,1\n" for stamp in stamps)
    drive = drive_of(tmp_path, "t_s,speed_mps,power_w\n" + rows)
    kept = [r.stamp_ns - START for r in drive.readings() if isinstance(r, SpeedReading)]
    assert kept == [1_000_000_000 * t for t in range(10)]
    assert drive.dropped == {"time_not_increasing": 1}


def long_table(times: list[str], header: str = "t_s,speed_mps,voltage_v,current_a") -> str:
    return "\n".join([header, *(f"{time},10,400,50" for time in times)]) + "\n"


def test_a_table_tells_how_long_it_is(tmp_path):
    """Before it is read: by all of its rows, or by those at its ends where it is a long one."""
    tenths = [f"{0.1 * i:.1f}" for i in range(5000)]
    assert drive_of(tmp_path, long_table(tenths)).seconds == pytest.approx(499.9)
    assert drive_of(tmp_path, long_table(tenths[:100])).seconds == pytest.approx(9.9)
    foreign = "Time (s),Speed (km/h),Voltage (V),Current (A)"
    assert drive_of(tmp_path, long_table(tenths, foreign)).seconds == pytest.approx(499.9, abs=1)
    newest_first = drive_of(tmp_path, long_table(tenths[::-1], foreign))
    assert newest_first.seconds == pytest.approx(499.9, abs=1)
    assert drive_of(tmp_path, long_table(tenths[::-1])).seconds == pytest.approx(499.9)
    pl.read_csv(tmp_path / "drive.csv").write_parquet(tmp_path / "drive.parquet")
    assert open_drive(tmp_path / "drive.parquet").seconds == pytest.approx(499.9)
    midnight = [f"{(23 * 60 + 59 + i) // 60 % 24:02d}:{(59 + i) % 60:02d}:00" for i in range(90)]
    assert drive_of(tmp_path, long_table(midnight, foreign)).seconds == 89 * 60
    cut = long_table(tenths)[:-30] + "?"  # within the last row
    assert drive_of(tmp_path, cut).seconds in (None, pytest.approx(499.8, abs=0.2))
    assert drive_of(tmp_path, long_table(tenths[:1])).seconds is None


@pytest.mark.parametrize(
    ("name", "heights", "options", "level"),
    [
        ("elevation_m", "0", (), True),
        ("elevation_m", "212.5", (), True),
        ("z [m]", "0", ["elevation=z [m]"], True),  # as its owner says
        ("Altitude [m]", "0", (), False),  # of a receiver that may have no fix
        ("elevation_m", "", (), False),
        ("elevation_m", None, (), False),
    ],
)
def test_heights_that_never_change_say_that_the_ground_is_level(
    tmp_path, name, heights, options, level
):
    rows = [f"{t},2,24,-3,{heights if heights is not None else t // 399}\n" for t in range(400)]
    path = tmp_path / "robot.csv"
    path.write_text(f"t_s,speed_mps,voltage_v,current_a,{name}\n" + "".join(rows))
    (tmp_path / "N48E011.hgt").touch()  # not used: the table has no positions
    for terrain in (None, Terrain(tmp_path)):
        drive = open_drive(path, 24.0, ReadOptions(columns=options, terrain=terrain))
        grades = [r.grade for r in drive.readings() if isinstance(r, kinds.GradeReading)]
        assert grades == [0.0] * 400 * level
        assert any("the road is assumed to be level" in note for note in drive.notes) == level
