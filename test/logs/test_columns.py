"""Strangers' CSV files: the same drive under other names, units, signs and separators."""

from contextlib import suppress
from datetime import datetime, timedelta
import math
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import DRIVE_START_NS, BatteryReading, SpeedReading
from evpinn_ros.logs.column import by_reason, columns_by_name
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.sources import open_drive
from evpinn_ros.logs.table_drive import TableDrive

NOMINAL = 350.0


def speed_at(time: float) -> float:
    """A drive in town, m/s: up to 15 m/s with 1.5 m/s^2."""
    return 7.5 - 7.5 * math.cos(time / 5.0)


def rows(count: int = 1200):
    for i in range(count):
        time = 0.1 * i
        acceleration = 1.5 * math.sin(time / 5.0)
        yield time, speed_at(time), 360.0, 20.0 + 60.0 * acceleration


def drive_of(folder: Path, header: str, lines, encoding: str = "utf-8", **options) -> TableDrive:
    text = "\n".join([header, *lines]) + "\n"
    (folder / "drive.csv").write_bytes(text.encode(encoding))
    return open_drive(folder / "drive.csv", NOMINAL, ReadOptions(**options))


def check(drive: TableDrive, start_ns: int = DRIVE_START_NS) -> None:
    """The readings are those of `rows`, in our units and with our signs."""
    readings = list(drive.readings())
    speeds = [r for r in readings if isinstance(r, SpeedReading)]
    batteries = [r for r in readings if isinstance(r, BatteryReading)]
    assert len(speeds) == len(batteries) == 1200 and not drive.dropped
    for (time, speed, voltage, current), s, b in zip(rows(), speeds, batteries, strict=True):
        assert s.stamp_ns - start_ns == pytest.approx(time * 1e9, abs=1e6)
        assert s.speed == pytest.approx(speed, abs=1e-3)
        assert b.power == pytest.approx(voltage * current, abs=2.0)


@pytest.mark.parametrize(
    ("name", "day"),
    [
        ("2024-03-05_07-08-09", "2024-03-05"),
        ("20240305070809", "2024-03-05"),
        ("log_240305", "2024-03-05"),
        ("car7 2024.03.05", "2024-03-05"),
        ("trip 2024-03-05 00-10", ""),  # of another time of day than the rows have
        ("120240305", ""),
        ("car7_1520240305_x", ""),
        ("2024-13-05", ""),
        ("box_991231", ""),  # no day of a log, but of a number
        ("box_070512", ""),
    ],
)
def test_a_day_in_the_files_name_is_that_of_its_times_of_day(tmp_path, name, day):
    path = tmp_path / f"{name}.csv"
    lines = (f"07:08:{t:06.3f},{v:.3f},{u},{i:.3f}" for t, v, u, i in rows(600))
    path.write_text("\n".join(["time,speed [m/s],pack volts,pack amps", *lines]))
    drive = open_drive(path, NOMINAL)
    first = next(iter(drive.readings())).stamp_ns
    date = str(np.datetime64(first, "ns").astype("datetime64[D]"))
    assert (date if drive.dated == "name" else "") == day


LANGUAGES = {
    "chinese": "数据时间(s),车速(km/h),总电压(V),总电流(A),环境温度(℃),SOC",
    "danish": "Tid (s),Hastighed (km/h),Batterispænding (V),Batteristrøm (A),Udetemperatur,SoC",
    "dutch": "Tijd (s),Snelheid (km/h),Spanning batterij (V),Stroom batterij (A),Buiten (°C),SoC",
    "french": "Temps (s),Vitesse (km/h),Tension batterie (V),Courant batterie (A),"
    "Température extérieure (°C),SoC",
    "italian": "Tempo (s),Velocità (km/h),Tensione batteria (V),Corrente batteria (A),"
    "Temperatura esterna (°C),SoC",
    "laboratory": "Time[s]_RawFacilities,Dyno_Spd[km/h],HVBatt_Volt_Hioki_U1[V],"
    "HVBatt_Curr_Hioki_I1[A],Ambient[C],Veh_soc_CAN[per]",
    "matlab": "time_s,v_veh_kmh,U_bat,I_bat,T_ambient,SoC",
    "polish": "Czas (s),Prędkość (km/h),Napięcie baterii (V),Prąd baterii (A),"
    "Temperatura zewnętrzna (°C),SoC",
    "spanish": "Tiempo (s),Velocidad (km/h),Tensión batería (V),Corriente batería (A),"
    "Temperatura exterior (°C),SoC",
}


@pytest.mark.parametrize(
    ("language", "encoding"),
    [*((name, "utf-8") for name in LANGUAGES), ("chinese", "gb18030"), ("french", "cp1252")],
)
def test_names_in_the_owners_language(tmp_path, language, encoding):
    lines = (f"{t:.1f},{3.6 * v:.3f},{u},{i:.3f},20.5,80" for t, v, u, i in rows())
    drive = drive_of(tmp_path, LANGUAGES[language], lines, encoding)
    check(drive)
    assert {"ambient", "charge"} <= {rule.quantity for rule in drive.rules}


ROWS = list(enumerate(rows()))


@pytest.mark.parametrize("clock", ["{:.2f}", "2024-03-05 07:08:{:05.2f}"])
def test_rows_in_no_order_are_sorted(tmp_path, clock, monkeypatch):
    monkeypatch.setattr("evpinn_ros.logs.table_drive.AT_ONCE", 100)
    monkeypatch.setattr("evpinn_ros.logs.batch.MOST_ROWS", 100)
    lines = [f"{clock.format(t / 2.1)},{3.6 * v:.4f},{u},{i:.4f}" for t, v, u, i in rows()]
    header = "time,speed_kmh,voltage,current"
    drive = drive_of(tmp_path, header, lines)
    wanted = [*map(repr, drive.readings())]
    mixed = np.random.default_rng(1).permutation(np.array(lines))
    again = drive_of(tmp_path, header, mixed)
    assert ([*map(repr, again.readings())], again.rules) == (wanted, drive.rules)
    assert (again.seconds, again.dropped) == (drive.seconds, drive.dropped)
    assert [note for note in again.notes if note not in drive.notes] == [
        "rows are not in order of time, so they were sorted"
    ]
    assert drive.in_order and not again.in_order


@pytest.mark.parametrize(("hour", "apart"), [(5, True), (7, False)])
def test_dated_drives_in_the_order_of_their_names_are_sorted(tmp_path, hour, apart):
    """A clock that goes through the same minutes again was set back: nobody knows how it stood."""
    lines = [
        f"2024-03-05 {at:02d}:08:{t / 2.1:05.2f},{3.6 * v:.4f},{u},{i:.4f}"
        for at in (7, hour)
        for t, v, u, i in rows()
    ]
    drive = drive_of(tmp_path, "time,speed_kmh,voltage,current", lines)
    readings = list(drive.readings())
    stamps = [reading.stamp_ns for reading in readings]
    assert stamps == sorted(stamps) and drive.in_order != apart
    assert (len(readings), not drive.dropped) == ((4800, True) if apart else (2400, False))


@pytest.mark.parametrize("name", ["kW", "Battery Power kW", "hvPower_kW"])
def test_a_power_named_by_its_unit_alone(tmp_path, name):
    lines = (f"{t:.1f},{3.6 * v:.4f},{u * i / 1000:.6f}" for t, v, u, i in rows())
    drive = drive_of(tmp_path, f"time,Speed (km/h),{name}", lines)
    assert {rule.quantity: rule.unit for rule in drive.rules}["power"] == "kw"
    powers = [r.power for r in drive.readings() if isinstance(r, BatteryReading)]
    assert powers == pytest.approx([u * i for _, _, u, i in rows()], abs=2.0)


def test_the_date_may_stand_beside_a_better_clock(tmp_path):
    """The second column has whole seconds, later and later; the first has none of the date."""
    lines = (
        f"{t:.1f},2023-04-19 09:19:{44 + int(t / 30)},{3.6 * v:.4f},{u},{i:.4f}"
        for t, v, u, i in rows()
    )
    drive = drive_of(tmp_path, "PhaseTime,Time,DAActualSpeed,REESSVoltage,REESSCurrent", lines)
    assert (drive.dated, drive.zoned) == ("log", False)
    first = next(drive.readings()).stamp_ns
    assert first == 1_681_895_984 * 10**9  # 2023-04-19 09:19:44


@pytest.mark.parametrize("days", [45_413, 0])
def test_serial_dates_of_a_spreadsheet_are_no_seconds(tmp_path, days):
    lines = (f"{days + 0.25 + t / 86400:.12f},{v:.4f},{u},{i:.4f}" for t, v, u, i in rows())
    with pytest.raises(
        InputError, match=r"'Date': '[\d.]+' is in no known format .* time=NAME:%d"
    ):
        drive_of(tmp_path, "Date,speed (m/s),hv_voltage,hv_current", lines)


@pytest.mark.parametrize(
    ("cell", "given"),
    [
        ("{:%Y%m%d-%H%M%S.%f}", "%Y%m%d-%H%M%S%.f"),
        ("{:%a %b %d %H:%M:%S.%f} GMT+02:00 2024", "%a %b %d %H:%M:%S%.f GMT%z %Y"),
    ],
)
def test_a_format_of_the_time_is_taken_as_given(tmp_path, cell, given):
    start = datetime(2024, 5, 1, 8)
    lines = (
        f"{cell.format(start + timedelta(seconds=t))},{v:.4f},{u},{i:.4f}" for t, v, u, i in rows()
    )
    header = "when: on board,speed (m/s),hv_voltage,hv_current"
    drive = drive_of(tmp_path, header, lines, columns=[f"time=when: on board:{given}"])
    assert drive.dated == "log" and drive.zoned == ("%z" in given)
    hours = 6 if drive.zoned else 8
    check(drive, 1_714_521_600_000_000_000 + hours * 3600 * 10**9)


def test_a_time_of_day_of_a_given_format_runs_over_midnight(tmp_path):
    times = ("23h59m58", "23h59m59", "00h00m01")
    lines = [f"{time},1,1,1" for time in times]
    header = "when,speed (m/s),hv_voltage,hv_current"
    drive = drive_of(tmp_path, header, lines, columns=["time=when:%Hh%Mm%S"])
    stamps = [r.stamp_ns for r in drive.readings() if isinstance(r, SpeedReading)]
    assert np.diff(stamps).tolist() == [1_000_000_000, 2_000_000_000]


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_times_since_1970_by_their_size(tmp_path, factor, unit):
    start = 1_700_000_000
    lines = (f"{(start + t) * factor:.0f},{v:.4f},{u},{i:.4f}" for t, v, u, i in rows())
    drive = drive_of(tmp_path, "time,speed (m/s),hv_voltage,hv_current", lines)
    check(drive, start * 1_000_000_000)
    assert drive.rules[0].unit == unit


def test_battery_before_motor_and_the_12_volt_net():
    header = ["t", "speed", "Motor Power [W]", "12V voltage", "Battery Voltage", "motor current"]
    header += ["battery current", "max battery current"]
    columns = {column.quantity: column.name for column in columns_by_name(header, [])}
    assert columns == {
        "time": "t",
        "speed": "speed",
        "voltage": "Battery Voltage",
        "current": "battery current",
    }


def test_the_cars_own_speed_before_that_of_a_phone_in_a_pocket(tmp_path):
    """LeafSpy names the phone's GPS `Speed`, and the car's own `Speed2`, in 0.01 km/h."""
    lines = (f"{t:.1f},0.0,{i % 7},{u},{c:.4f},{360 * v:.1f}" for i, (t, v, u, c) in ROWS)
    drive = drive_of(tmp_path, "t_s,Speed,Gids,Pack Volts,Pack Amps, Speed2", lines)
    rules = {rule.quantity: rule for rule in drive.rules}
    assert (rules["speed"].name, rules["speed"].unit) == ("Speed2", "0.01 km/h")
    check(drive)
    chosen = drive_of(
        tmp_path,
        "t_s,Speed,Gids,Pack Volts,Pack Amps, Speed2",
        ["0,1,1,1,1,1"] * 9,
        columns=["speed=Speed:km/h"],
    )
    assert {rule.name for rule in chosen.rules if rule.quantity == "speed"} == {"Speed"}


WRONG = [
    ("speed", "say QUANTITY=NAME"),
    ("weight=a", "say QUANTITY=NAME"),
    ("speed=nowhere", "no such column; there are t, v, u"),
    ("speed=v:furlong", "the unit is one of m/s"),
]


@pytest.mark.parametrize(("text", "reason"), WRONG)
def test_a_wrong_choice_is_refused(text, reason):
    with pytest.raises(InputError, match=reason):
        columns_by_name(["t", "v", "u"], [text])


@given(st.lists(st.text(max_size=12), max_size=8))
def test_any_header_is_taken_or_left(header):
    with suppress(InputError):  # a bracket that is no unit
        for column in columns_by_name(header, []):
            assert header[column.place] == column.name and math.isfinite(column.factor)


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("GPS Latitude", True),
        ("Latitude (°)", True),
        ("Lat offset (m)", False),
        ("Lat acceleration (g)", False),
        ("Lat Term Fuel Trim", False),
    ],
)
def test_what_is_no_place_ends_no_file(tmp_path, name, place):
    header = f"time (s),Vehicle speed (km/h),Battery voltage (V),Battery current (A),{name}"
    lines = (f"{t:.1f},{3.6 * v:.4f},{u:.1f},{i:.4f},48.1" for t, v, u, i in rows())
    drive = drive_of(tmp_path, header, lines)
    assert ("latitude" in {rule.quantity for rule in drive.rules}) == place
    check(drive)


def test_an_empty_column_gives_way_to_a_full_one(tmp_path):
    """VED has two of air conditioning, of which one is empty."""
    path = tmp_path / "ved.csv"
    header = "Timestamp(s),Vehicle Speed[km/h],HV Battery Voltage[V],HV Battery Current[A]"
    header += ",Air Conditioning Power[kW],Air Conditioning Power[Watts]\n"
    rows = "".join(f"{i},{i % 50},350,{-(i % 9)},,{600 + i}\n" for i in range(100))
    path.write_text(header + rows, encoding="utf-8")
    (aircon,) = (rule for rule in open_drive(path).rules if rule.quantity == "aircon")
    assert aircon.name == "Air Conditioning Power[Watts]"
    path.write_text(header + rows.replace(",,", ",0.6,"), encoding="utf-8")
    (aircon,) = (rule for rule in open_drive(path).rules if rule.quantity == "aircon")
    assert aircon.name == "Air Conditioning Power[kW]"


def test_columns_that_are_not_used_are_told_apart_by_the_reason(tmp_path):
    lines = (
        f"{t:.1f},{3.6 * v:.3f},{3.6 * v:.2f},{u},{i:.3f},,{u * i:.0f},3" for t, v, u, i in rows()
    )
    header = "time,Vehicle speed (km/h),GPS Speed (km/h),Pack Volts,Pack Amps,Heater Power [W],"
    drive = drive_of(tmp_path, f"{header}Motor Pwr(w),gear", lines)
    assert by_reason(drive.ignored) == {
        "speed is read from 'Vehicle speed (km/h)'": ["GPS Speed (km/h)"],
        "empty": ["Heater Power [W]"],
        "not of the whole traction battery": ["Motor Pwr(w)"],
        "not needed": ["gear"],
    }


def test_a_unit_that_is_not_known_costs_no_drive_that_can_do_without(tmp_path):
    lines = (f"{t:.1f},{v:.3f},{u},{i:.3f},80,15" for t, v, u, i in rows())
    header = "t_s,Speed [m/s],Pack Volts,Pack Amps,SOC [bars],Ambient [gas mark]"
    drive = drive_of(tmp_path, header, lines)
    assert drive.ignored == {
        "SOC [bars]": "the unit [bars] of charge is not known",
        "Ambient [gas mark]": "the unit [gas mark] of ambient is not known",
    }
