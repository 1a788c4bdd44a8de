"""A drive written in any format reads back the same, and a broken table never lies."""

import math
from pathlib import Path
import random
import sys

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from formats import CLOCKS, CURRENTS, SPEEDS, START, VOLTAGES, Style, drive, polled_at, write

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import (
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.logs.sources import open_drive

pytestmark = pytest.mark.slow

FOLDER = [HealthCheck.function_scoped_fixture]
ROWS = drive(150, 2.5)


@st.composite
def styles(draw):
    separator, comma = draw(
        st.sampled_from([(",", False), (";", True), ("\t", False), (";", False)])
    )
    layout = draw(st.sampled_from(["wide", "wide", "polled", "long"]))
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]))
    return Style(
        clock=draw(st.sampled_from(sorted(CLOCKS))),
        speed=draw(st.sampled_from(sorted(SPEEDS))),
        voltage=draw(st.sampled_from(sorted(VOLTAGES))),
        current=draw(st.sampled_from(sorted(CURRENTS))),
        separator=separator,
        comma=comma,
        thousands=draw(st.booleans()),
        quoted=draw(st.booleans()),
        encoding=encoding,
        end=draw(st.sampled_from(["\n", "\r\n"])),
        sep_line=draw(st.booleans()) and encoding != "utf-16",
        polled=layout == "polled",
        long=layout == "long",
        zipped=draw(st.booleans()),
        torn=draw(st.integers(0, 5)),
        rows=draw(st.sampled_from(["oldest first"] * 4 + ["newest first", "in no order"])),
        seed=draw(st.integers(0, 99)),
    )


def signals(readings):
    """Times, s since the first row, and values of each signal."""
    found = {name: [] for name in ("speed", "voltage", "current", "charge", "height", "ambient")}
    for reading in readings:
        at = reading.stamp_ns / 1e9
        if isinstance(reading, SpeedReading):
            found["speed"].append((at, reading.speed))
        if isinstance(reading, AltitudeReading):
            found["height"].append((at, reading.altitude))
        if isinstance(reading, TemperatureReading):
            found["ambient"].append((at, reading.celsius))
        if isinstance(reading, BatteryReading):
            values = reading.voltage, -reading.current, 100 * reading.state_of_charge
            for name, value in zip(("voltage", "current", "charge"), values, strict=True):
                if not math.isnan(value):
                    found[name].append((at, value))
    return found


def columns_of(style):
    return {
        "speed": style.speed,
        "voltage": style.voltage,
        "current": style.current,
        "charge": "State of charge (%)",
        "height": "Altitude (ft)",
        "ambient": "Ambient air temp(°F)",
    }


@pytest.mark.nightly
@settings(max_examples=60, deadline=None, suppress_health_check=FOLDER)
@given(style=styles())
def test_a_drive_in_any_format_reads_back_the_same(tmp_path, style):
    source = open_drive(write(tmp_path, ROWS, style))
    readings = list(source.readings())
    stamps = [reading.stamp_ns for reading in readings]
    assert stamps == sorted(stamps)
    dated = CLOCKS[style.clock][2]
    assert source.dated == ("log" if dated else ""), source.clock
    found = signals(readings)
    for name, column in columns_of(style).items():
        times = [at for at, _ in found[name]]
        assert len(times) == len(ROWS), (name, source.rules, dict(source.dropped))
        begin = START.timestamp() if dated else times[0] - polled_at(style, column)
        for row, (at, value) in zip(ROWS, found[name], strict=True):
            assert at - begin == pytest.approx(row.time + polled_at(style, column), abs=2e-3)
            assert value == pytest.approx(getattr(row, name), abs=1e-2), name


def assert_honest(path):
    """Refused in one line, or readings that are finite and in order, and at least one of them."""
    try:
        readings = list(open_drive(path).readings())
    except InputError as error:
        assert "\n" not in str(error) and str(path) in str(error)
        return
    assert readings
    stamps = [reading.stamp_ns for reading in readings]
    assert stamps == sorted(stamps) and stamps[0] > 0
    for reading in readings:
        values = {
            SpeedReading: lambda r: [r.speed],
            AltitudeReading: lambda r: [r.altitude],
            TemperatureReading: lambda r: [r.celsius],
            AuxiliaryReading: lambda r: [r.heating, r.others],
            BatteryReading: lambda r: [
                v for v in (r.voltage, r.current, r.state_of_charge) if not math.isnan(v)
            ],
        }[type(reading)](reading)
        assert values and all(map(math.isfinite, values)), reading


@settings(max_examples=40, deadline=None, suppress_health_check=FOLDER)
@given(style=styles(), seed=st.integers(0, 2**32), changes=st.integers(1, 40))
def test_a_damaged_table_never_lies(tmp_path, style, seed, changes):
    chance = random.Random(seed)
    path = write(tmp_path, ROWS[:40], style)
    data = bytearray(path.read_bytes())
    for _ in range(changes):
        kind, at = chance.randrange(4), chance.randrange(len(data))
        if kind == 0:
            data[at] = chance.randrange(256)
        elif kind == 1:
            del data[at : at + chance.randrange(1, 50)]
        elif kind == 2:
            data[at:at] = chance.choice(
                [b'"', b";", b",", b"\n", b"1e308", b"-inf", b"nan", b"\0"]
            )
        else:
            end = at + chance.randrange(200)
            data[at:at] = data[at:end]
        if not data:
            break
    path.write_bytes(data)
    assert_honest(path)


@settings(max_examples=80, deadline=None, suppress_health_check=FOLDER)
@given(data=st.text(alphabet="time,speedvoltagcurn;\n\t 0123456789.-:+/\"'[]()", max_size=400))
def test_any_text_is_refused_or_read(tmp_path, data):
    path = tmp_path / "drive.csv"
    path.write_text("time,speed,voltage,current\n" + data)
    assert_honest(path)


def test_a_cell_of_a_space_that_does_not_break_is_no_name(tmp_path):
    """Found by the fuzzer: such a cell is empty once it is stripped."""
    path = tmp_path / "drive.csv"
    path.write_bytes("inf,\u00a0\n??,\u00a01\n??,\u00a0\n".encode())
    with pytest.raises(InputError, match="no column of time and speed"):
        open_drive(path, 350.0)
