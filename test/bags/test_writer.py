import os
from pathlib import Path
import resource

from mcap.reader import make_reader
import pytest
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader
import yaml

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import decode, encode, new_message, typestore
from evpinn_ros.bags.writer import BagWriter, Split
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import SpeedReading
from evpinn_ros.topics.messages import named_vector, scalar
from evpinn_ros.topics.readings import speed_message

START = 1_700_000_000_000_000_000
STEP = 50_000_000


def write(folder: Path, count: int = 200) -> Path:
    with BagWriter(folder) as writer:
        for i in range(count):
            stamp = START + i * STEP
            message = speed_message(new_message, SpeedReading(stamp, i * 0.1))
            writer.write("/ev/vehicle/speed", message, stamp)
            if i % 20 == 0:
                vector = named_vector(new_message, stamp, ["mass"], [1800.0 + i])
                writer.write("/ev/estimate/reliable", vector, stamp)
    return folder


def the_mcap(folder: Path) -> Path:
    (path,) = folder.glob("*.mcap")
    return path


def test_rosbags_reads_what_was_written(tmp_path):
    with Reader(write(tmp_path / "drive")) as reader:
        assert reader.message_count == 210
        assert reader.duration == 199 * STEP + 1
        connections = {connection.topic: connection for connection in reader.connections}
        speeds = [
            typestore().deserialize_cdr(data, connection.msgtype).twist.twist.linear.x
            for connection, _, data in reader.messages([connections["/ev/vehicle/speed"]])
        ]
    assert speeds == [i * 0.1 for i in range(200)]


def test_latched_topics_are_offered_latched(tmp_path):
    folder = write(tmp_path / "drive")
    for source in (folder, the_mcap(folder)):
        with Reader(source) as reader:
            offered = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}
        assert offered["/ev/estimate/reliable"].durability == QosDurability.TRANSIENT_LOCAL
        assert offered["/ev/estimate/reliable"].depth == 1
        assert offered["/ev/vehicle/speed"].durability == QosDurability.VOLATILE
        assert offered["/ev/vehicle/speed"].reliability == QosReliability.RELIABLE


def test_metadata_is_that_of_jazzy(tmp_path):
    text = (write(tmp_path / "drive") / "metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["storage_identifier"] == "mcap"
    assert information["relative_file_paths"] == ["drive_0.mcap"]
    assert information["message_count"] == 210
    assert information["starting_time"]["nanoseconds_since_epoch"] == START
    assert "&id" not in text  # yaml-cpp resolves references, other readers do not


def test_the_same_writes_give_the_same_bytes(tmp_path):
    first, second = (write(tmp_path / name / "drive") for name in "ab")
    assert the_mcap(first).read_bytes() == the_mcap(second).read_bytes()
    assert (first / "metadata.yaml").read_bytes() == (second / "metadata.yaml").read_bytes()


def test_nothing_is_overwritten(tmp_path):
    folder = write(tmp_path / "drive")
    with pytest.raises(InputError, match="a bag is there already; use another name or remove it"):
        BagWriter(folder)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "a.txt").touch()
    with pytest.raises(InputError, match="not empty and not a bag"):
        BagWriter(tmp_path / "notes")
    with pytest.raises(InputError, match="a file is there"):
        BagWriter(tmp_path / "notes" / "a.txt")
    with pytest.raises(InputError, match="Not a directory"):
        BagWriter(tmp_path / "notes" / "a.txt" / "drive")


def test_a_topic_keeps_its_type(tmp_path):
    with BagWriter(tmp_path / "drive") as writer:
        writer.write("/a", scalar(new_message, 1.0), START)
        with pytest.raises(ValueError, match="/a is std_msgs/msg/Float64"):
            writer.write("/a", new_message("std_msgs/msg/Empty"), START)


def test_an_exception_leaves_a_whole_bag(tmp_path):
    with pytest.raises(ZeroDivisionError), BagWriter(tmp_path / "drive") as writer:
        writer.write("/a", scalar(new_message, 1.0), START)
        raise ZeroDivisionError
    with Reader(tmp_path / "drive") as reader:
        assert reader.message_count == 1


def test_late_messages_make_no_chunks_of_their_own(tmp_path):
    with BagWriter(tmp_path / "drive") as writer:
        for i in range(200):  # as power/smoothed does: 3 s behind
            writer.write("/a", scalar(new_message, i), START + i * STEP)
            writer.write("/b", scalar(new_message, i), START + i * STEP - 3 * 10**9)
    with the_mcap(tmp_path / "drive").open("rb") as file:
        assert make_reader(file).get_summary().statistics.chunk_count == 10
    with BagReader(tmp_path / "drive") as reader:
        times = [record.log_time_ns for record in reader.records()]
    assert len(times) == 400 and times == sorted(times)


def test_a_live_recording_is_flushed_by_wall_time_too(tmp_path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("evpinn_ros.bags.writer.time.monotonic", lambda: now[0])
    writer = BagWriter(tmp_path / "drive", live=True)
    for i in range(100):  # log time stands
        now[0] += 0.1
        writer.write("/a", scalar(new_message, i), START)
    with BagReader(tmp_path / "drive") as reader:  # not closed: as after a kill
        assert len(list(reader.records())) >= 90
    writer.close()
    writer.close()
    with BagReader(tmp_path / "drive") as reader:
        assert len(list(reader.records())) == 100 and reader.problem is None


def test_decoding_anything_gives_a_message_or_a_value_error():
    raw = encode(named_vector(new_message, START, ["a", "b"], [1.0, 2.0]))
    for cut in range(len(raw)):
        with pytest.raises(ValueError):
            decode("sensor_msgs/msg/JointState", raw[:cut])


def test_a_bag_goes_on_in_another_file_after_some_time(tmp_path):
    folder = tmp_path / "drive"
    with BagWriter(folder, split=Split(seconds=3.0)) as writer:
        for i in range(200):
            message = speed_message(new_message, SpeedReading(START + i * STEP, i * 0.1))
            writer.write("/ev/vehicle/speed", message, START + i * STEP)
    names = [f"drive_{i}.mcap" for i in range(4)]
    assert sorted(path.name for path in folder.glob("*.mcap")) == names
    information = yaml.safe_load((folder / "metadata.yaml").read_text())
    information = information["rosbag2_bagfile_information"]
    assert information["relative_file_paths"] == names
    assert [file["message_count"] for file in information["files"]] == [60, 60, 60, 20]
    assert [file["duration"]["nanoseconds"] for file in information["files"]] == [
        59 * STEP,
        59 * STEP,
        59 * STEP,
        19 * STEP,
    ]
    starts = [file["starting_time"]["nanoseconds_since_epoch"] for file in information["files"]]
    assert starts == [START + 60 * i * STEP for i in range(4)]
    assert information["message_count"] == 200
    with Reader(folder) as reader:
        assert [t for _, t, _ in reader.messages()] == [START + i * STEP for i in range(200)]
    with BagReader(folder) as reader:
        assert len(list(reader.records())) == 200 and reader.problem is None
    with Reader(folder / "drive_3.mcap") as reader:  # each file is whole by itself
        assert reader.message_count == 20


def test_a_bag_goes_on_in_another_file_when_one_is_full(tmp_path):
    folder = tmp_path / "drive"
    with BagWriter(folder, split=Split(size=20_000)) as writer:
        for i in range(2000):
            writer.write_raw("/a", "std_msgs/msg/String", os.urandom(100), START + i * STEP)
    sizes = [path.stat().st_size for path in folder.glob("*.mcap")]
    assert len(sizes) > 5 and max(sizes) < 30_000
    with Reader(folder) as reader:
        assert reader.message_count == 2000 == sum(1 for _ in reader.messages())


@pytest.mark.parametrize("there", [False, True])
def test_where_nothing_fits_nothing_is_left(tmp_path, there):
    """The limit of a file's size fails as a full disk does; what is left would be in the way."""
    folder = tmp_path / "bag"
    if there:
        folder.mkdir()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))
    try:
        with pytest.raises(InputError, match="bag: File too large"):
            BagWriter(folder)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [*tmp_path.rglob("*")] == ([folder] if there else [])
    BagWriter(folder).close()
