"""A broken table never lies."""

import math
from pathlib import Path
import random
import sys

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from random_exports import random_export

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
@given(seed=st.integers(0, 2**32), changes=st.integers(1, 40))
def test_a_damaged_table_never_lies(tmp_path, seed, changes):
    chance = random.Random(seed)
    path = tmp_path / "drive.csv"
    data = bytearray(random_export(seed).data[:4000])
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
