"""Raw CAN frames in bags: written, read back, and used like any CAN log."""

from dataclasses import replace
from pathlib import Path

from mcap.writer import Writer
import pytest
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from evpinn_ros.bags.convert import write_readings
from evpinn_ros.bags.types import decode, encode, encode_frame, new_message, typestore
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.logs import LogFile, write_log
from evpinn_ros.can.profile import load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.bag_source import BagSource
from evpinn_ros.logs.bus_sources import BagFrames, CanLogSource, open_can_log
from evpinn_ros.logs.contents import contents
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.sources import open_source
from evpinn_ros.topics import FRAME_TYPE

NOW = 1_700_000_000 * 10**9
FRAMES = [
    CanFrame(NOW + 1, 0x132, bytes(range(8))),
    CanFrame(NOW + 2, 0x18FF0001, b"", extended=True),
    CanFrame(NOW + 3, 0x132, b"\x01\x02\x03"),
]


def message(frame, **fields):
    stamp = new_message(
        "builtin_interfaces/msg/Time", sec=frame.stamp_ns // 10**9, nanosec=frame.stamp_ns % 10**9
    )
    return new_message(
        FRAME_TYPE,
        header=new_message(
            "std_msgs/msg/Header", stamp=stamp, frame_id=fields.pop("frame_id", "")
        ),
        id=frame.can_id,
        is_extended=frame.extended,
        dlc=len(frame.data),
        data=list(frame.data.ljust(8, b"\0")),
        **fields,
    )


def write(folder, frames, topic="/ev/can/frames"):
    with BagWriter(folder) as writer:
        for frame in frames:
            writer.write_raw(topic, FRAME_TYPE, encode_frame(frame), frame.stamp_ns)
    return folder


@pytest.mark.parametrize("frame", FRAMES)
def test_the_struct_is_the_message(frame):
    assert encode_frame(frame) == encode(message(frame))
    assert encode(decode(FRAME_TYPE, encode_frame(frame))) == encode_frame(frame)


@pytest.mark.parametrize(
    "frame", [CanFrame(NOW, 1, bytes(12)), CanFrame(-1, 1, b""), CanFrame(2**62, 1, b"")]
)
def test_what_the_message_cannot_hold_is_refused(frame):
    with pytest.raises(ValueError, match="cannot hold"):
        encode_frame(frame)


def test_frames_come_back_from_the_folder_and_from_the_bare_file(tmp_path):
    folder = write(tmp_path / "bag", FRAMES)
    for path in (folder, next(folder.glob("*.mcap"))):
        log = open_can_log(path)
        assert list(log.frames()) == FRAMES
        assert log.count == 3 and log.problem is None and not log.skipped


def test_frames_of_sqlite3_and_of_other_publishers(tmp_path):
    """As ros2_socketcan names its frame, and as rosbag2 stored by default until Iron."""
    with RosbagsWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        for topic in ("/from_can_bus", "/to_can_bus"):
            connection = bag.add_connection(topic, FRAME_TYPE, typestore=typestore())
            for frame in FRAMES:
                bag.write(connection, frame.stamp_ns, encode(message(frame, frame_id="can")))
            bag.write(connection, NOW + 4, encode(message(FRAMES[0], is_error=True)))
            bag.write(connection, NOW + 4, encode(message(FRAMES[0], is_rtr=True)))
    log = open_can_log(tmp_path / "bag")
    assert list(log.frames()) == FRAMES
    assert log.skipped == {"error_frame": 1, "remote_frame": 1}


def test_a_header_without_time_takes_the_log_time(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/frames", message(CanFrame(0, 1, b"\x07")), NOW)
    assert list(open_can_log(tmp_path / "bag").frames()) == [CanFrame(NOW, 1, b"\x07")]


def test_a_broken_recording_gives_what_is_left_and_says_so(tmp_path):
    frames = [CanFrame(NOW + i * 10**7, 0x132, i.to_bytes(8, "little")) for i in range(1000)]
    file = next(write(tmp_path / "bag", frames).glob("*.mcap"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    log = open_can_log(file)
    read = list(log.frames())
    assert 100 < len(read) < 1000 and read == frames[: len(read)]
    assert str(file) in log.problem


def test_an_id_of_two_topics_is_read_from_one(tmp_path):
    ids = [("/a", 1), ("/b", 1), ("/b", 2)]
    with BagWriter(tmp_path / "two") as writer:
        for topic, can_id in ids * 2:
            frame = CanFrame(NOW, can_id, topic.encode())
            writer.write_raw(topic, FRAME_TYPE, encode_frame(frame), NOW)
    log = BagFrames(tmp_path / "two")
    assert {(frame.can_id, frame.data) for frame in log.frames()} == {(1, b"/a"), (2, b"/b")}
    assert log.count == 4 and log.skipped == {"other_bus": 2}


def test_bags_without_frames_are_refused(tmp_path):
    with pytest.raises(InputError, match="no CAN frames"):
        BagFrames(Path(__file__).parents[2] / "bags" / "urban")
    writer = Writer(str(tmp_path / "odd.mcap"))
    writer.start()
    schema = writer.register_schema(FRAME_TYPE, "ros2msg", b"")
    writer.add_message(writer.register_channel("/x", "cdr", schema), NOW, b"\0\1\0\0x", NOW)
    writer.finish()
    with pytest.raises(InputError, match="no CAN data frame"):
        list(BagFrames(tmp_path / "odd.mcap").frames())


@pytest.fixture
def drive():
    encoder, frames = Encoder(load_profile("tesla_model_3")), []
    for index in range(50):
        frames.append(encoder.battery(BatteryReading(NOW + index * 10**7, 380.0, -index / 2)))
        frames.append(encoder.speed(SpeedReading(NOW + index * 10**7, index / 5)))
    return frames


def test_a_bag_of_frames_replays_as_its_log_does(tmp_path, drive):
    write_log(tmp_path / "drive.log", drive)
    car = load_vehicle("tesla_model_3_lr")
    log = open_source(tmp_path / "drive.log", car)
    bag = open_source(write(tmp_path / "bag", drive), car)
    assert isinstance(bag, CanLogSource)
    assert list(map(repr, bag.readings())) == list(map(repr, log.readings()))
    assert list(LogFile(tmp_path / "drive.log").frames()) == drive
    with pytest.raises(InputError, match="names no CAN profile"):
        open_source(tmp_path / "bag", load_vehicle("generic"))


def test_frames_of_one_of_several_cars(tmp_path, drive):
    others = [replace(frame, data=bytes(8)) for frame in drive]
    with BagWriter(tmp_path / "bag") as writer:
        for pair in zip(others, drive, strict=True):
            for topic, frame in zip(("/a/can/frames", "/b/can/frames"), pair, strict=True):
                writer.write_raw(topic, FRAME_TYPE, encode_frame(frame), frame.stamp_ns)
    car = load_vehicle("tesla_model_3_lr")
    write_log(tmp_path / "drive.log", drive)
    log = [*open_source(tmp_path / "drive.log", car).readings()]
    for name in ("b", "/b"):
        bag = open_source(tmp_path / "bag", car, ReadOptions(car=name))
        assert [*map(repr, bag.readings())] == [*map(repr, log)]
    assert contents(tmp_path / "bag", ReadOptions(car="b")).frames == len(drive)
    with pytest.raises(InputError, match="no frame of the bus 'b'; there are can0"):
        list(open_source(tmp_path / "drive.log", car, ReadOptions(car="b")).readings())


def test_topics_of_several_cars_are_not_passed_over_for_their_frames(tmp_path, drive):
    with BagWriter(tmp_path / "bag") as writer:
        for name in ("/a", "/b"):
            write_readings([SpeedReading(NOW, 1.0)], writer, name)
            for frame in drive:
                topic = f"{name}/can/frames"
                writer.write_raw(topic, FRAME_TYPE, encode_frame(frame), frame.stamp_ns)
    with pytest.raises(InputError, match="topics of 2 cars, /a, /b; say --car NAME"):
        open_source(tmp_path / "bag", load_vehicle("tesla_model_3_lr"))
    assert "topics of 2 cars" in contents(tmp_path / "bag").notes[0]


def test_recorded_topics_go_before_frames_unless_a_profile_is_named(tmp_path, drive):
    with BagWriter(tmp_path / "bag") as writer:
        for frame in drive:
            writer.write_raw("/ev/can/frames", FRAME_TYPE, encode_frame(frame), frame.stamp_ns)
        twist = new_message("geometry_msgs/msg/TwistWithCovarianceStamped")
        writer.write("/ev/vehicle/speed", twist, NOW)
    car = load_vehicle("tesla_model_3_lr")
    assert isinstance(open_source(tmp_path / "bag", car), BagSource)
    again = open_source(tmp_path / "bag", car, ReadOptions("tesla_model_3"))
    assert isinstance(again, CanLogSource) and len(list(again.readings())) == len(drive)
