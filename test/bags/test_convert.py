from dataclasses import astuple
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from evpinn_ros.bags.convert import BagReadings, write_readings
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import new_message
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals import readings as kinds
from evpinn_ros.core.signals.readings import BatteryReading, Reading, SpeedReading
from evpinn_ros.topics.messages import scalar
from evpinn_ros.topics.readings import speed_message

START = 1_700_000_000_000_000_000
NUMBERS = st.floats(-1e6, 1e6, width=32).map(lambda x: x + 0.0)
STAMPS = st.integers(START, START + 10**10)
READINGS = st.one_of(
    st.builds(SpeedReading, STAMPS, NUMBERS),
    st.builds(BatteryReading, STAMPS, NUMBERS, NUMBERS | st.just(math.nan)),
    st.builds(kinds.GradeReading, STAMPS, st.floats(-0.5, 0.5)),
    st.builds(kinds.AltitudeReading, STAMPS, NUMBERS),
    st.builds(kinds.AltitudeReading, STAMPS, NUMBERS, st.floats(1, 90), st.floats(-180, 180)),
    st.builds(kinds.TemperatureReading, STAMPS, NUMBERS),
    st.builds(kinds.PressureReading, STAMPS, NUMBERS),
    st.builds(kinds.WindReading, STAMPS, NUMBERS),
    st.builds(kinds.AuxiliaryReading, STAMPS, NUMBERS, NUMBERS),
    st.builds(kinds.MotorReading, STAMPS, NUMBERS, NUMBERS | st.just(math.nan)),
)


def same(first: Reading, second: Reading) -> bool:
    return type(first) is type(second) and astuple(first) == pytest.approx(
        astuple(second), rel=0, abs=1e-8, nan_ok=True
    )


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(readings=st.lists(READINGS, min_size=1, max_size=30))
def test_readings_survive_a_bag(tmp_path_factory, readings):
    folder = tmp_path_factory.mktemp("convert") / "drive"
    with BagWriter(folder) as writer:
        assert not write_readings(readings, writer)
    with BagReader(folder) as reader:
        back = BagReadings(reader)
        result = list(back)
    assert not back.dropped
    expected = sorted(readings, key=lambda reading: reading.stamp_ns)
    assert len(result) == len(expected)
    assert all(same(*pair) for pair in zip(result, expected, strict=True))


def test_a_battery_reading_makes_three_topics(tmp_path):
    with BagWriter(tmp_path / "a") as writer:
        write_readings([BatteryReading(START, 400.0, -50.0)], writer)
        write_readings([BatteryReading(START, 400.0, math.nan)], writer)
    with BagReader(tmp_path / "a") as reader:
        assert {name: info.count for name, info in reader.topics.items()} == {
            "/ev/battery/state": 2,
            "/ev/battery/voltage": 2,
            "/ev/battery/current": 1,
        }
        (record,) = reader.records(["/ev/battery/current"])
    assert record.message.data == -50.0 and record.log_time_ns == START


def test_what_no_message_can_hold_is_counted(tmp_path):
    readings = [
        SpeedReading(START, math.nan),
        SpeedReading(-1, 1.0),
        BatteryReading(START, 1e39, 1.0),
        SpeedReading(START, 1.0),
    ]
    with BagWriter(tmp_path / "a") as writer:
        assert write_readings(readings, writer) == {"not_finite_or_out_of_range": 3}
    with BagReader(tmp_path / "a") as reader:
        assert len(list(BagReadings(reader))) == 1


@pytest.mark.parametrize("namespace", ["", "/", "/car7", "/fleet/car7"])
def test_any_namespace_is_read(tmp_path, namespace):
    with BagWriter(tmp_path / "a") as writer:
        write_readings([SpeedReading(START, 1.0)], writer, namespace)
        writer.write("/wheels/speed", scalar(new_message, 1.0), START)
    with BagReader(tmp_path / "a") as reader:
        readings = BagReadings(reader)
        assert readings.topics == (f"{namespace.rstrip('/')}/vehicle/speed",)
        assert [reading.speed for reading in readings] == [1.0]


def test_a_topic_that_was_nearly_ours_is_named(tmp_path):
    speed = speed_message(new_message, SpeedReading(START, 1.0))
    with BagWriter(tmp_path / "a") as writer:
        writer.write("/ev/vehicle/sped", speed, START)
        writer.write("/ev/battery/state", scalar(new_message, 1.0), START)
        writer.write("/lidar/points", scalar(new_message, 1.0), START)
    near = "topic /ev/vehicle/sped is not known; did you mean vehicle/speed"
    with BagReader(tmp_path / "a") as reader, pytest.raises(InputError) as refused:
        BagReadings(reader)
    assert near in str(refused.value) and "lidar" not in str(refused.value)
    assert "its type is std_msgs/msg/Float64, not sensor_msgs" in str(refused.value)


def test_bad_messages_are_counted(tmp_path):
    good = speed_message(new_message, SpeedReading(START, 1.0))
    nan = speed_message(new_message, SpeedReading(START, 1.0))
    nan.twist.twist.linear.x = math.nan
    unstamped = new_message("geometry_msgs/msg/TwistWithCovarianceStamped")
    with BagWriter(tmp_path / "a") as writer:
        for message in (good, nan, unstamped, unstamped):
            writer.write("/ev/vehicle/speed", message, START)
        writer.write_raw("/ev/vehicle/speed", good.__msgtype__, b"\x00\x01\x00\x00broken", START)
    with BagReader(tmp_path / "a") as reader:
        readings = BagReadings(reader)
        assert len(list(readings)) == 1
        assert readings.dropped == {"not_finite": 1, "no_stamp": 2, "undecodable": 1}
