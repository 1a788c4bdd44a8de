"""Real captures of three cars against what was decoded from them by other means.

The data is not part of the package: without it these tests are skipped.
"""

import csv
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.logs import LogFile
from evpinn_ros.can.profile import MOTORS, load_profile
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from test.can.conftest import ALL

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "can"
pytestmark = [
    pytest.mark.skipif(not DATA.is_dir(), reason="no captures beside the checkout"),
    pytest.mark.nightly,
]

LEAF = ("EV-CANeplus2", "EV-CANeplus3", "EV-CANepluseco")
TESLA = [
    (
        "tesla_model_s",
        DATA / "tesla_model_s_2017" / "models_2017-02-19.candump.log",
        DATA / "tesla_model_s_2017" / "decoded_2017-02-19.csv",
    ),
    (
        "tesla_model_3_2019",
        DATA / "tesla_model3_2019" / "drive_first_300s.candump.log",
        DATA / "tesla_model3_2019" / "decoded_first_300s.csv",
    ),
]


SECONDS = 90  # of a capture: a profile is chosen within ten, and looked at again each second


@cache
def frames(path):
    """Frames of a capture, which many tests here look at."""
    return list(LogFile(path).frames())


def first_frames(path):
    end_ns = frames(path)[0].stamp_ns + SECONDS * 10**9
    return [frame for frame in frames(path) if frame.stamp_ns < end_ns]


def without_motors(profile):
    return {name: rule for name, rule in profile.messages.items() if name not in MOTORS}


def decode(profile, path):
    """The decoder after the log, and arrays of time (s from the first frame) and values."""
    profile = load_profile(profile)
    decoder = Decoder(replace(profile, messages=without_motors(profile)))
    speed, battery, start = [], [], None
    for frame in frames(path):
        start = frame.stamp_ns if start is None else start
        for reading in decoder.decode(frame):
            time = (reading.stamp_ns - start) / 1e9
            if isinstance(reading, SpeedReading):
                speed.append((time, reading.speed))
            elif isinstance(reading, BatteryReading):
                battery.append((time, reading.voltage, reading.current, reading.state_of_charge))
    return decoder, np.array(speed), np.array(battery)


def column(rows, name):
    return np.array([float(row[name]) for row in rows])


def table(path):
    rows = list(csv.DictReader(path.open()))
    columns = [column(rows, name) for name in ("t_s", "speed_mps", "voltage_v", "current_a")]
    # The tables count discharge as positive, BatteryState as negative.
    return columns[0], columns[1], columns[2], -columns[3]


@pytest.mark.parametrize(("profile", "log", "decoded"), TESLA)
def test_tesla_equals_the_table_to_its_digits(profile, log, decoded):
    decoder, speed, battery = decode(profile, log)
    at, *expected = table(decoded)
    got = [
        np.interp(at, speed[:, 0], speed[:, 1]),
        np.interp(at, battery[:, 0], battery[:, 1]),
        np.interp(at, battery[:, 0], battery[:, 2]),
    ]
    for mine, theirs, half_digit in zip(got, expected, (0.0005, 0.005, 0.05), strict=True):
        within = np.abs(mine - theirs) <= half_digit * 1.01
        assert within.mean() > 0.98  # the rest lies in gaps, which the table fills its own way
    assert not decoder.dropped and len(speed) + len(battery) > 0.9 * decoder.known


@pytest.mark.parametrize("name", LEAF)
def test_leaf_equals_the_table(name):
    folder = DATA / "nissan_leaf_62kwh"
    decoder, speed, battery = decode("nissan_leaf", folder / f"{name}.candump.log")
    at, motor_speed, voltage, current = table(folder / f"decoded_{name}.csv")
    # Averages over 50 ms: each lies between the readings around it.
    for column_, expected in ((1, voltage), (2, current)):
        for time, value in zip(at, expected, strict=True):
            near = battery[np.abs(battery[:, 0] - time) <= 0.06, column_]
            assert near.min() <= value <= near.max()
    moving = motor_speed > 5
    ratio = np.interp(at, speed[:, 0], speed[:, 1])[moving] / motor_speed[moving]
    assert abs(ratio.mean() - 1) < 0.005
    assert np.quantile(np.abs(ratio - 1), 0.95) < 0.02
    assert np.all((battery[:, 3] > 0.5) & (battery[:, 3] < 1.0) | np.isnan(battery[:, 3]))
    assert not decoder.dropped


CAPTURES = [
    *((profile, log) for profile, log, _ in TESLA),
    *(("nissan_leaf", DATA / "nissan_leaf_62kwh" / f"{name}.candump.log") for name in LEAF),
]


@pytest.mark.parametrize("patient", [False, True])
@pytest.mark.parametrize(("right", "log"), CAPTURES, ids=lambda value: Path(value).stem)
def test_the_guard_lets_out_the_right_profile_alone(right, log, patient):
    first = first_frames(log)
    for profile in ALL:
        plain = CanBridge(profile)
        bridge = CanBridge(profile, guard=FitGuard(profile, ALL, patient=patient))
        got = [reading for frame in first for reading in bridge.decode(frame)]
        got += bridge.finish()
        if profile.key == right:
            assert repr(got) == repr([r for frame in first for r in plain.decode(frame)])
        else:
            assert not got, profile.key
