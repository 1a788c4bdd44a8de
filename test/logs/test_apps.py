"""The layouts of apps, as their exports or their readers show them; clocks, units, refusals."""

from datetime import datetime, timedelta, timezone
import gzip
import json
import math
import os
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from evpinn_ros.can.logs import LogFile
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import (
    AltitudeReading,
    BatteryReading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.logs.apps import layout_of
from evpinn_ros.logs.contents import contents
from evpinn_ros.logs.formats import is_drive_table
from evpinn_ros.logs.sources import open_drive

DATA = Path(__file__).parents[2].parent / "shared" / "data"
START = datetime(2024, 3, 5, 7, 8, 9, tzinfo=timezone.utc)
SECONDS = 300


def moments():
    """Time, its date, speed, voltage, current, positive while it discharges, charge, height."""
    for t in range(SECONDS):
        speed = 8 - 8 * math.cos(t / 8)
        current = 15 + 5 * speed * math.sin(t / 8)
        yield t, START + timedelta(seconds=t), speed, 380 - 0.1 * current, current, 80.0, 100.0


def table(header, row):
    return "\n".join([header, *(row(*moment) for moment in moments())]) + "\n"


def carscanner_long():
    lines = ['"SECONDS";"PID";"VALUE";"UNITS";"LATITUDE";"LONGTITUDE";']
    for t, _, speed, voltage, current, charge, height in moments():
        values = [
            ("Vehicle speed", speed * 3.6, "km/h"),
            ("Speed (GPS)", 200, "km/h"),
            ("[BMS] HV battery voltage", voltage, "V"),
            ("[BMS] HV battery current", current, "A"),
            ("Engine RPM", 0, "rpm"),
            ("State of charge", charge, "%"),
            ("Altitude (GPS)", height, "m"),
        ]
        lines += [
            f'"{86_350 + t + 0.1 * k:.6f}";"{name}";"{value:.4f}";"{unit}";"45.1";"15.2";'
            for k, (name, value, unit) in enumerate(values)
        ]
    return "\n".join(lines) + "\n"


APPS = {
    "2024-03-05 23-59-09.csv": (carscanner_long, "name"),
    "torque.csv": (
        lambda: table(
            "GPS Time, Device Time, Longitude, Latitude,GPS Speed (Meters/second), Altitude,"
            "Speed (OBD)(km/h),[LEAF] HV Battery Voltage(V),[LEAF] HV Battery Current(A),"
            "Voltage (OBD Adapter)(V),Trip Time(Since journey start)(s),State of charge(%)",
            lambda t, at, v, u, i, s, h: (
                f"{at:%a %b %d %H:%M:%S} GMT+00:00 2024,{at:%d-%b-%Y %H:%M:%S}.000,1,2,-,{h},"
                f"{v * 3.6:.4f},{u:.4f},{-i:.4f},12.5,{t},{s}"
            ),
        ),
        "log",
    ),
    "obdfusion.csv": (
        lambda: (
            "# StartTime = 03/05/2024 07:08:09.0000 AM\n"
            + table(
                "Time (sec), Vehicle speed (MPH), Battery voltage (V), Battery current (A)",
                lambda t, at, v, u, i, s, h: f"{t:.4f},{v / 0.44704:.5f},{u:.4f},{i:.4f}",
            )
        ),
        "log",
    ),
    "ovms.csv": (
        lambda: table(
            "time,v.p.speed,v.b.voltage,v.b.current,v.b.soc,v.e.temp,v.b.12v.voltage,v.b.temp",
            lambda t, at, v, u, i, s, h: (
                f"{at:%Y-%m-%d %H:%M:%S},{v * 3.6:.4f},{u:.4f},{i:.4f},{s},5,12.8,20"
            ),
        ),
        "log",
    ),
    "abrp.csv": (
        lambda: table(
            "utc,soc,power,speed,lat,lon,is_charging,ext_temp,elevation,voltage,current",
            lambda t, at, v, u, i, s, h: (
                f"{at.timestamp():.0f},{s},{u * i / 1000},{v * 3.6:.4f},1,2,0,5,{h},"
                f"{u:.4f},{i:.4f}"
            ),
        ),
        "log",
    ),
}


@pytest.mark.parametrize("name", APPS)
def test_an_app_is_read_without_a_flag(tmp_path, name):
    made, dated = APPS[name]
    (tmp_path / name).write_text(made(), encoding="utf-8-sig")
    drive = open_drive(tmp_path / name)
    readings = list(drive.readings())
    assert drive.dated == dated and not drive.dropped and not drive.first_bad
    speeds = [r for r in readings if isinstance(r, SpeedReading)]
    places = {(r.latitude, r.longitude) for r in readings if isinstance(r, AltitudeReading)}
    assert ((1.0, 2.0) in places) == (name == "abrp.csv")
    currents = [r for r in readings if isinstance(r, BatteryReading) and not math.isnan(r.current)]
    voltages = [r.voltage for r in readings if isinstance(r, BatteryReading)]
    assert len(speeds) == len(currents) == SECONDS
    assert min(v for v in voltages if not math.isnan(v)) > 360
    for (t, at, speed, *_), reading in zip(moments(), speeds, strict=True):
        begin = 86_350 - 7 * 3600 - 8 * 60 - 9 if name.startswith("2024") else 0
        assert reading.stamp_ns / 1e9 == pytest.approx(at.timestamp() + begin, abs=1e-3), t
        assert reading.speed == pytest.approx(speed, abs=1e-3)
    for (*_, current, _, _), reading in zip(moments(), currents, strict=True):
        assert reading.current == pytest.approx(-current, abs=1e-3)


def test_teslamate_has_power_alone_in_kilowatts(tmp_path):
    header = "id,date,elevation,speed,power,odometer,est_battery_range_km,battery_level,"
    header += "battery_heater_no_power,inside_temp,outside_temp,is_climate_on"
    text = table(
        header,
        lambda t, at, v, u, i, s, h: (
            f"{t},{at:%Y-%m-%d %H:%M:%S.%f},{h:.0f},{v * 3.6:.0f},{u * i / 1000:.0f},"
            f"{1000 + t / 99:.3f},300,{s:.0f},f,21.5,5.0,t"
        ),
    )
    (tmp_path / "positions.csv").write_text(text)
    source = open_drive(tmp_path / "positions.csv", 360.0)
    units = {rule.quantity: rule.unit for rule in source.rules}
    assert (units["speed"], units["power"], units["ambient"]) == ("km/h", "kw", "c")
    powers = [r.power for r in source.readings() if isinstance(r, BatteryReading)]
    assert max(powers) == pytest.approx(25_000, rel=0.1)
    assert "300 battery readings have power only" in source.notes[-1]


def typed():
    rows = list(moments())
    return {
        "Date": [at.replace(tzinfo=None) for _, at, *_ in rows],
        "Speed [km/h]": [speed * 3.6 for _, _, speed, *_ in rows],
        "Pack Voltage": [row[3] for row in rows],
        "Pack Current": [row[4] for row in rows],
    }


MELTED = {
    "pandas": ("t,variable,value", "{t},{name},{value}"),
    "pandas, dated": ("time,variable,value", "{at:%Y-%m-%d %H:%M:%S},{name},{value}"),
    "influx": (
        "#group,false,false,false,false,true\n"
        "#datatype,string,long,dateTime:RFC3339,double,string\n#default,_result,,,,\n"
        ",result,table,_time,_value,_field",
        ",,0,{at:%Y-%m-%dT%H:%M:%SZ},{value},{name}",
    ),
}


@pytest.mark.parametrize("kind", MELTED)
def test_signals_that_follow_each_other_are_read_together(tmp_path, kind):
    header, row = MELTED[kind]
    signals = {"speed_kmh": 2, "pack_voltage": 3, "pack_current": 4, "rpm": 0}
    lines = [
        row.format(t=moment[0], at=moment[1], name=name, value=f"{moment[place]:.6f}")
        for name, place in signals.items()
        for moment in moments()
    ]
    path = tmp_path / "drive.csv"
    path.write_text("\n".join([header, *lines]) + "\n")
    drive = open_drive(path)
    readings = list(drive.readings())
    stamps = [reading.stamp_ns for reading in readings]
    assert stamps == sorted(stamps) and not drive.dropped and not drive.in_order
    assert drive.seconds == SECONDS - 1
    for kind, place, of in (
        (SpeedReading, 2, lambda r: 3.6 * r.speed),
        (BatteryReading, 3, lambda r: r.voltage),
        (BatteryReading, 4, lambda r: -r.current),
    ):
        values = [of(r) for r in readings if isinstance(r, kind)]
        values = [value for value in values if not math.isnan(value)]
        assert values == pytest.approx([moment[place] for moment in moments()], abs=1e-5)


def test_tables_of_columns_and_spreadsheets(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    columns = typed()
    table = pl.DataFrame({**columns, "nested": [[1]] * SECONDS})
    table.write_parquet(tmp_path / "d.parquet")
    table.write_ipc(tmp_path / "d.feather")
    table.write_ndjson(tmp_path / "d.jsonl")
    rows = json.loads(table.write_json())
    trips = [{"samples": rows[:40]}, {"samples": rows[40:]}]
    document = {"app": {"name": "x", "devices": [{"id": 1}]}, "trips": trips}
    (tmp_path / "d.json").write_text(json.dumps(document))
    book = openpyxl.Workbook()
    book.active.append(["notes of mine"])
    sheet = book.create_sheet("data")
    sheet.append(["Leaf, March"])
    sheet.append(["Date", "Time", *list(columns)[1:]])
    for at, *values in zip(*columns.values(), strict=True):
        sheet.append([at.date(), at.time(), *values])
    book.save(tmp_path / "d.xlsx")
    for name in ("d.parquet", "d.feather", "d.jsonl", "d.json", "d.xlsx"):
        speeds = [r for r in open_drive(tmp_path / name).readings() if isinstance(r, SpeedReading)]
        assert len(speeds) == SECONDS
        assert speeds[0].stamp_ns == START.timestamp() * 1e9
        assert speeds[20].speed == pytest.approx(8 - 8 * math.cos(2.5))


def test_lines_of_json_are_read_whatever_one_of_them_is(tmp_path):
    """A logger that was ended left half a line; Python writes NaN; some cells are text."""
    lines = [
        json.dumps({"t_s": t, "speed_mps": v, "power_w": 9.0 + t, "place": {"lat": 1}, "a": "b\n"})
        for t, v in enumerate([1.0, 2.0, 3.0, math.nan, *range(5, 101)])
    ]
    torn = lines[2][:20] + lines[1]
    (tmp_path / "d.jsonl").write_text("\n".join(["", *lines[:2], torn, *lines[3:], "[1]", "{"]))
    drive = open_drive(tmp_path / "d.jsonl")
    readings = list(drive.readings())
    assert [r.speed for r in readings if isinstance(r, SpeedReading)] == [1, 2, *range(5, 101)]
    assert sum(isinstance(r, BatteryReading) for r in readings) == 99
    assert "3 lines are no JSON objects, the first is line 4" in drive.problem


@pytest.mark.parametrize("suffix", [".parquet", ".feather"])
def test_times_of_day_and_durations_of_columns_keep_parts_of_a_second(tmp_path, suffix):
    steps = [timedelta(milliseconds=100 * i) for i in range(50)]
    of_day = [(START + step).time() for step in steps]
    for times in (steps, of_day):
        table = pl.DataFrame({"time": times, "speed": 50 * [1.0], "power": 50 * [9.0]})
        save = table.write_parquet if suffix == ".parquet" else table.write_ipc
        save(tmp_path / f"d{suffix}")
        drive = open_drive(tmp_path / f"d{suffix}")
        stamps = [r.stamp_ns for r in drive.readings() if isinstance(r, SpeedReading)]
        assert np.diff(stamps).tolist() == 49 * [100_000_000]


@pytest.mark.parametrize(
    ("name", "package", "extra"), [("d.xlsx", "openpyxl", "tables"), ("d.mf4", "asammdf", "mf4")]
)
def test_a_package_that_is_missing_is_told_in_words(tmp_path, monkeypatch, name, package, extra):
    (tmp_path / f"{package}.py").write_text(f"raise ModuleNotFoundError(name={package!r})")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    (tmp_path / name).write_bytes(b"anything")
    with pytest.raises(InputError, match=rf"{package} is not installed: .*evpinn_ros\[{extra}\]"):
        open_drive(tmp_path / name)


def test_measured_signals_of_an_mf4(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    np = pytest.importorskip("numpy")
    rows = np.array([[t, v * 3.6, u, i] for t, _, v, u, i, *_ in moments()])
    mdf = asammdf.MDF()
    mdf.start_time = START
    names = [("VehicleSpeed", "km/h"), ("HV_Battery_Voltage", "V"), ("HV_Battery_Current", "A")]
    for k, (name, unit) in enumerate(names, 1):
        mdf.append([asammdf.Signal(rows[:, k], rows[:, 0] + 0.1 * k, name=name, unit=unit)])
    mdf.save(tmp_path / "d.mf4")
    readings = list(open_drive(tmp_path / "d.mf4").readings())
    assert len(readings) == 3 * SECONDS
    assert readings[0].stamp_ns == pytest.approx((START.timestamp() + 0.1) * 1e9, abs=1e6)


def test_savvycan(tmp_path):
    path = tmp_path / "bus.csv"
    path.write_text(
        "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
        "39747828,000005EB,false,Rx,0,8,E8,45,85,4B,4A,28,36,69,\n"
        "39757828,18DAF110,true,Tx,0,2,01,FF,\n"
    )
    assert not is_drive_table(path)
    first, second = LogFile(path).frames()
    assert (first.can_id, first.extended, first.data.hex()) == (0x5EB, False, "e845854b4a283669")
    assert second.stamp_ns - first.stamp_ns == 10_000_000
    assert (second.can_id, second.extended, second.data) == (0x18DAF110, True, b"\x01\xff")


@pytest.mark.parametrize("first", [4_294_000_000, 2**33 + 4_294_000_000, -1_769_872_318_259_854])
def test_the_counter_of_savvycan_runs_on(tmp_path, first):
    """It wraps at 32 bits in some adapters, and is negative after an overflow."""
    path = tmp_path / "bus.csv"
    wraps = 2**32 if first == 4_294_000_000 else 2**63
    rows = (
        f"{(first + 500_000 * i) % wraps if first > 0 else first + 500_000 * i}" for i in range(9)
    )
    lines = "".join(f"{stamp},000005EB,false,Rx,0,1,E8,\n" for stamp in rows)
    path.write_text("Time Stamp,ID,Extended,Dir,Bus,LEN,D1\n" + lines)
    stamps = [frame.stamp_ns for frame in LogFile(path).frames()]
    assert [stamp - stamps[0] for stamp in stamps] == [500_000_000 * i for i in range(9)]
    assert stamps[0] >= 0


def small(folder, header, *rows):
    (folder / "drive.csv").write_text("\n".join([header, *rows]) + "\n")
    return open_drive(folder / "drive.csv")


def times(source):
    readings = [r for r in source.readings() if isinstance(r, SpeedReading)]
    return [(r.stamp_ns - readings[0].stamp_ns) / 1e9 for r in readings]


def test_dates_that_can_be_read_in_two_ways_are_told(tmp_path):
    rows = [f"05/03/2024 07:08:{s:02d},{s}" for s in range(30)]
    drive = small(tmp_path, "date,speed_mps,power_w", *(f"{row},1" for row in rows))
    assert drive.clock.why == "day, month, year; could be month, day, year as well"
    later = [row.replace("05/03", "03/25") for row in rows]
    drive = small(tmp_path, "date,speed_mps,power_w", *(f"{row},1" for row in later))
    assert drive.clock.why == "month, day, year"
    drive = small(tmp_path, "date,speed_mps,power_w", *(f"{row},1" for row in rows))
    for name, order in (("Log_240503_1", "month, day, year"), ("20240305", "day, month, year")):
        again = (tmp_path / "drive.csv").rename(tmp_path / f"{name}.csv")
        assert open_drive(again).clock.why == order, "the name of the file decides"
        again.rename(tmp_path / "drive.csv")
    over = ["31/12/2023 23:59:59,1,1", "01/01/2024 00:00:00,1,1", "01/01/2024 00:00:01,1,1"]
    assert times(small(tmp_path, "date,speed_mps,power_w", *over)) == [0, 1, 2]


def test_times_of_day_go_on_over_midnight(tmp_path):
    day = ["23:59:58,1,1", "23:59:59,1,1", "00:00:01,1,1", "00:00:02,1,1"]
    source = small(tmp_path, "time,speed_mps,power_w", *day)
    assert times(source) == [0, 1, 3, 4] and source.dated == ""
    described = contents(tmp_path / "drive.csv")
    assert described.dated == "" and described.columns[0].unit == "time of day"


def test_fahrenheit_is_not_taken_for_celsius(tmp_path):
    header, row = "t_s,speed_mps,power (W),ambient", "{},1,1000,{}"
    for values, celsius in (((41, 45), 5.0), ((3, 8), 3.0), ((20, 38), 20.0)):
        rows = [row.format(i, values[0] if i < 6 else values[1]) for i in range(11)]
        source = small(tmp_path, header, *rows)
        ambient = [r.celsius for r in source.readings() if isinstance(r, TemperatureReading)]
        assert ambient[0] == pytest.approx(celsius)
        why = next(rule.why for rule in source.rules if rule.quantity == "ambient")
        assert "its median" in why


def test_a_thousands_sign_is_no_decimal_one(tmp_path):
    rows = [
        f'{i},{i}.5,"{value}"' for i, value in enumerate(("950", "12,345", "27,521", "-1,004"))
    ]
    source = small(tmp_path, "t_s,speed_mps,battery power (W)", *rows)
    powers = [r.power for r in source.readings() if isinstance(r, BatteryReading)]
    assert powers == pytest.approx([950, 12_345, 27_521, -1004])


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="no shared data")
def test_real_logs_are_read_with_no_flag():
    folders = "peugeot_e208_car_scanner", "nissan_leaf_2013_leafspy"
    logs = [log for folder in folders for log in sorted((DATA / folder).iterdir())]
    assert len(logs) == 56
    for log in logs[::8]:
        drive = open_drive(log)
        readings = list(drive.readings())
        assert not drive.first_bad and "wrong_number_of_cells" not in drive.dropped
        assert "time_not_increasing" not in drive.dropped and drive.dated
        units = {rule.quantity: rule.unit for rule in drive.rules}
        assert units["speed"] in ("km/h", "0.01 km/h") and not units["current"].startswith("-")
        kinds = {type(reading).__name__ for reading in readings}
        assert {"BatteryReading", "TemperatureReading"} <= kinds
        volts = [r.voltage for r in readings if isinstance(r, BatteryReading)]
        assert 340 < min(v for v in volts if not math.isnan(v)) < 440
        temperatures = [r.celsius for r in readings if isinstance(r, TemperatureReading)]
        assert -10 < min(temperatures) <= max(temperatures) < 50


def test_months_of_other_languages_and_a_byte_of_windows(tmp_path):
    lines = ["date,speed (km/h),power (kW),Ambient"]
    lines += [
        f"05-{month}-2024 07:0{k}:00,36,1,7" for k, month in enumerate(("déc.", "dez", "dic"))
    ]
    (tmp_path / "d.csv").write_text("\n".join([*lines, "05-Dec-2024 07:03:00,36,1,7", ""]))
    source = open_drive(tmp_path / "d.csv")
    assert times(source) == [0, 60, 120, 180] and source.dated == "log"
    rows = [f"{i},1,1,warm 7 °C" for i in range(3000)]
    text = "\n".join(["t_s,speed_mps,power_w,note", *rows])
    (tmp_path / "w.csv").write_bytes(text.encode("cp1252"))
    assert len(times(open_drive(tmp_path / "w.csv"))) == 3000


VERSIONS = ["Log_leaf_170704_01133", "Log_leaf_171026_01133", "Log_leaf_180927_24CA1"]


@pytest.mark.skipif(not DATA.is_dir(), reason="no shared data")
@pytest.mark.parametrize("name", VERSIONS)
def test_a_continuation_of_leafspy_is_read_as_the_whole_log(tmp_path, name):
    text = gzip.decompress((DATA / f"nissan_leaf_2013_leafspy/{name}.csv.gz").read_bytes()).decode(
        "latin-1"
    )
    text = "".join(text.splitlines(keepends=True)[:400])
    header, _, below = text.partition("\n")
    (tmp_path / "whole.csv").write_text(text, "latin-1")
    (tmp_path / "continued.csv").write_text(below, "latin-1")
    whole, continued = (open_drive(tmp_path / f"{stem}.csv") for stem in ("whole", "continued"))
    assert repr(list(continued.readings())) == repr(list(whole.readings()))  # NaN is no place
    ours = layout_of(
        next(row for row in (line.split(",") for line in below.split("\n")) if row[30:])
    )
    assert len(ours) == header.count(",") + 1
