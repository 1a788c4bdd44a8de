"""Batteries of bags and CAN logs that are not what they say: the log is read, and it is said."""

from dataclasses import replace
import math
from pathlib import Path

import pytest

from evpinn_ros.bags.convert import write_readings
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.logs import write_log
from evpinn_ros.can.profile import load_profile
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.sources import open_source
from test.conftest import ROOT

VEHICLE = load_vehicle("tesla_model_3_lr")
CHANGES = {
    "right": lambda reading: reading,
    "zero": lambda reading: replace(reading, current=0.0),
    "turned": lambda reading: replace(reading, current=-reading.current),
    "unsigned": lambda reading: replace(reading, current=-abs(reading.current)),
    "one way": lambda reading: replace(reading, current=min(reading.current, 0.0)),
}


@pytest.fixture(scope="module")
def readings():
    return list(open_source(ROOT / "bags" / "urban", VEHICLE).readings())


@pytest.mark.parametrize(
    ("change", "note"),
    [
        ("right", None),
        ("zero", "current is always 0 A while the car speeds up"),
        ("turned", "the car speeds up while its battery is charged: the sign of the current"),
        ("unsigned", "the harder the car brakes, the more the battery seems to give"),
        ("one way", "no current ever flows back into the battery"),
    ],
)
@pytest.mark.parametrize("kind", ["bag", "CAN log"])
def test_what_the_battery_cannot_be_is_said(change, note, kind, readings, tmp_path: Path):
    begin_ns = readings[0].stamp_ns + 30_000_000_000  # the battery is heard half a minute later
    changed = [
        CHANGES[change](reading) if isinstance(reading, BatteryReading) else reading
        for reading in readings
        if isinstance(reading, SpeedReading) or reading.stamp_ns >= begin_ns
    ]
    if kind == "bag":
        path = tmp_path / "drive"
        with BagWriter(path) as writer:
            write_readings(changed, writer)
    else:
        path = tmp_path / "drive.log"
        encoder = Encoder(load_profile(VEHICLE.can_profile))
        write_log(
            path,
            [
                encoder.speed(r) if isinstance(r, SpeedReading) else encoder.battery(r)
                for r in changed
                if isinstance(r, SpeedReading | BatteryReading)
            ],
        )
    source = open_source(path, VEHICLE)
    batteries = [r for r in source.readings() if isinstance(r, BatteryReading)]
    assert len(batteries) == sum(isinstance(r, BatteryReading) for r in changed)
    assert all(math.isnan(r.current) for r in batteries) == (change == "zero")
    assert [text for text in source.notes if note and text.startswith(note)] == list(source.notes)
    assert len(source.notes) == (note is not None)
