from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
import zstandard

from evpinn_ros.bags.metadata import METADATA
from evpinn_ros.bags.names import is_bag
from evpinn_ros.bags.reader import BagReader, TopicInfo
from evpinn_ros.bags.types import encode, new_message, typestore
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.topics.messages import scalar
from evpinn_ros.topics.readings import battery_message, speed_message

START = 1_700_000_000_000_000_000
STEP = 100_000_000
COUNT = 300
FLOAT = "std_msgs/msg/Float64"


def write(folder: Path, count: int = COUNT) -> Path:
    with BagWriter(folder) as writer:
        for i in range(count):
            stamp = START + i * STEP
            speed = speed_message(new_message, SpeedReading(stamp, float(i)))
            battery = battery_message(new_message, BatteryReading(stamp, 400.0, float(-i)))
            writer.write("/ev/vehicle/speed", speed, stamp)
            writer.write("/ev/battery/state", battery, stamp)
    return folder


def test_raw_records_are_the_bytes_of_the_records(tmp_path):
    with BagReader(write(tmp_path / "bag", 3)) as bag:
        raw, whole = list(bag.raw_records()), list(bag.records())
    assert [r.message for r in raw] == [encode(r.message) for r in whole]
    assert [(r.topic, r.type_name, r.log_time_ns) for r in raw] == [
        (r.topic, r.type_name, r.log_time_ns) for r in whole
    ]


def write_rosbags(folder: Path, plugin: StoragePlugin, *compression: object) -> Path:
    writer = RosbagsWriter(folder, version=9, storage_plugin=plugin)
    if compression:
        writer.set_compression(*compression)
    with writer:
        connection = writer.add_connection("/a", FLOAT, typestore=typestore())
        for i in range(COUNT):
            writer.write(connection, START + i * STEP, encode(scalar(new_message, i)))
    return folder


def write_mcap(
    path: Path, message_encoding: str = "cdr", profile: str = "", **options: object
) -> Path:
    """An MCAP file as some other program may write it."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2000, **options)
        writer.start(profile=profile)
        schema = writer.register_schema(FLOAT, "ros2msg", b"float64 data")
        channel = writer.register_channel("/a", message_encoding, schema)
        for i in range(COUNT):
            data = encode(scalar(new_message, i))
            writer.add_message(channel, START + i * STEP, data, START + i * STEP)
        writer.finish()
    return path


def mcap_of(folder: Path) -> Path:
    (path,) = folder.glob("*.mcap")
    return path


def numbers(path: Path) -> tuple[list[float], str | None]:
    with BagReader(path) as reader:
        values = [record.message.data for record in reader.records()]
        return values, reader.problem


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("reader") / "drive")


def test_a_folder_its_file_and_a_folder_without_metadata(drive, tmp_path):
    bare = tmp_path / "bare"
    bare.mkdir()
    (bare / "x.mcap").write_bytes(mcap_of(drive).read_bytes())
    for path in (drive, mcap_of(drive), bare, str(drive)):
        with BagReader(path) as reader:
            assert reader.topics == {
                "/ev/battery/state": TopicInfo("sensor_msgs/msg/BatteryState", COUNT),
                "/ev/vehicle/speed": TopicInfo(
                    "geometry_msgs/msg/TwistWithCovarianceStamped", COUNT
                ),
            }
            records = list(reader.records())
            assert [record.log_time_ns for record in records[::2]] == [
                START + i * STEP for i in range(COUNT)
            ]
            assert reader.problem is None and not reader.dropped


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("compressed", [None, CompressionMode.MESSAGE, CompressionMode.FILE])
def test_bags_of_rosbags(tmp_path, plugin, compressed):
    compression = (compressed, CompressionFormat.ZSTD) if compressed else ()
    folder = write_rosbags(tmp_path / "bag", plugin, *compression)
    (file,) = (path for path in folder.iterdir() if path.name != METADATA)
    for path in (folder, file):
        assert is_bag(path) and numbers(path) == (list(range(COUNT)), None)


def test_a_compressed_recording_that_the_power_ended(tmp_path):
    """rosbag2 writes metadata.yaml at the end, and compresses a file when the next one began."""
    folder = write_rosbags(
        tmp_path / "bag", StoragePlugin.MCAP, CompressionMode.FILE, CompressionFormat.ZSTD
    )
    (packed,) = folder.glob("*.zstd")
    with packed.open("rb") as source, packed.with_suffix("").open("wb") as target:
        zstandard.ZstdDecompressor().copy_stream(source, target)
    assert numbers(folder) == (list(range(COUNT)), None)  # both are there, as zstd -d leaves them
    packed.with_suffix("").unlink()
    (folder / "metadata.yaml").unlink()
    assert numbers(folder) == (list(range(COUNT)), None)
    write_mcap(folder / "bag_1.mcap")
    both = sorted(2 * list(range(COUNT)))
    assert numbers(folder) == (both, None)
    with (folder / "bag_1.mcap.zstd").open("wb") as cut:
        cut.write(b"begun")
    assert numbers(folder) == (both, None)


OPTIONS = [
    {},
    {"compression": CompressionType.LZ4},
    {"compression": CompressionType.NONE},
    {"use_chunking": False},
    {"index_types": IndexType.NONE},
    {"use_statistics": False},
    {"repeat_channels": False},
    {"repeat_schemas": False},
    {"enable_crcs": False},
    {"use_summary_offsets": False, "use_statistics": False, "index_types": IndexType.NONE,
     "repeat_channels": False, "repeat_schemas": False},
    {"use_chunking": False, "use_statistics": False, "repeat_channels": False},
]  # fmt: skip


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_mcap_of_any_kind(tmp_path, options):
    path = write_mcap(tmp_path / "a.mcap", **options)
    assert numbers(path) == (list(range(COUNT)), None)
    with BagReader(path) as reader:
        assert reader.topics == {"/a": TopicInfo(FLOAT, COUNT)}


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_every_cut_is_read_as_far_as_it_goes(tmp_path, options):
    whole = write_mcap(tmp_path / "a.mcap", **options).read_bytes()
    cut = tmp_path / "cut.mcap"
    before = 0
    for size in [*range(8, len(whole), 307), len(whole) - 1]:
        cut.write_bytes(whole[:size])
        values, problem = numbers(cut)
        assert values == list(range(len(values)))
        assert len(values) >= before and problem
        before = len(values)
    assert before == COUNT


@pytest.mark.slow
@settings(
    max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
def test_a_damaged_byte_costs_a_chunk_and_is_reported(drive, tmp_path, data):
    whole = mcap_of(drive).read_bytes()
    position = data.draw(st.integers(8, len(whole) - 1))
    damaged = bytearray(whole)
    damaged[position] ^= data.draw(st.integers(1, 255))
    path = tmp_path / "damaged.mcap"
    path.write_bytes(damaged)
    with BagReader(path) as reader:
        times = [record.log_time_ns for record in reader.records()]
        assert times == sorted(times)
        assert len(times) >= 2 * COUNT - 20  # a chunk holds a second: ten of each
        assert len(times) == 2 * COUNT or reader.problem


def test_damage_says_how_much_was_lost(drive, tmp_path):
    damaged = bytearray(mcap_of(drive).read_bytes())
    with mcap_of(drive).open("rb") as file:
        (*_, hit) = [
            chunk.chunk_start_offset
            for chunk in make_reader(file).get_summary().chunk_indexes
            if chunk.chunk_start_offset < len(damaged) // 4
        ]
    damaged[hit + 100] ^= 255
    path = tmp_path / "damaged.mcap"
    path.write_bytes(damaged)
    with BagReader(path) as reader:
        assert len(list(reader.records())) == 580
        assert reader.problem == (
            f"{path}: cut or damaged at byte {hit} of {len(damaged)}: damaged; "
            "1 of 30 chunks are damaged; 20 messages lost; 580 messages are readable"
        )


def test_unknown_types_and_encodings_are_counted(tmp_path):
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        kinds = [("my_msgs/msg/Own", "cdr"), (FLOAT, "json"), (FLOAT, "cdr"), (FLOAT, "cdr")]
        for i, (type_name, encoding) in enumerate(kinds):
            schema = writer.register_schema(type_name, "ros2msg", b"float64 data")
            channel = writer.register_channel(f"/{i}", encoding, schema)
            data = encode(scalar(new_message, i))
            writer.add_message(channel, START, data if i != 3 else data[:9], START)
        writer.finish()
    with BagReader(tmp_path / "a.mcap") as reader:
        assert [record.topic for record in reader.records()] == ["/2"]
        assert reader.dropped == {"unknown_type": 1, "not_cdr": 1, "undecodable": 1}
        assert [record.topic for record in reader.records(["/2"])] == ["/2"]
        assert not reader.dropped


def test_files_of_a_folder_are_merged_by_time(tmp_path):
    for name, offset in (("a", 0), ("b", STEP // 2)):
        with BagWriter(tmp_path / name) as writer:
            for i in range(50):
                writer.write(f"/{name}", scalar(new_message, i), START + i * STEP + offset)
    both = tmp_path / "both"
    both.mkdir()
    for name in "ab":
        (both / f"{name}.mcap").write_bytes(mcap_of(tmp_path / name).read_bytes())
    (both / "c.mcap").touch()
    with BagReader(both) as reader:
        assert [record.topic for record in reader.records()] == ["/a", "/b"] * 50
        assert reader.problem == f"{both / 'c.mcap'}: the file is empty"


def test_metadata_that_lists_more_or_is_broken(drive, tmp_path):
    folder = tmp_path / "drive"
    folder.mkdir()
    (folder / "other.mcap").write_bytes(mcap_of(drive).read_bytes())
    metadata = (drive / "metadata.yaml").read_bytes()
    for text, problem in ((metadata, "lists missing files: drive_0.mcap"), (b"{", "ignored")):
        (folder / "metadata.yaml").write_bytes(text)
        with BagReader(folder) as reader:
            assert len(list(reader.records())) == 2 * COUNT
            assert problem in reader.problem


def test_the_folder_around_bags_is_told_from_one_without(drive):
    with pytest.raises(InputError, match=f"there are bags inside it: .*{drive.name}"):
        BagReader(drive.parent)


def test_a_cut_or_damaged_database_is_refused_or_reported(tmp_path):
    folder = write_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3)
    whole = next(folder.glob("*.db3")).read_bytes()
    broken = [whole[:size] for size in range(100, len(whole), 4001)]
    for begin in range(0, len(whole), 4096):
        broken.append(whole[:begin] + b"\xff" * 100 + whole[begin + 100 :])
    broken.append(whole.replace(b"CREATE TABLE", b"CREATE T\xe9BLE"))  # text that is none
    reported = 0
    for content in broken:
        (tmp_path / "a.db3").write_bytes(content)
        try:
            values, problem = numbers(tmp_path / "a.db3")
        except InputError as error:
            assert str(error).count("a.db3") == 1
            continue
        assert problem or values == list(range(COUNT))
        reported += problem is not None
    assert reported
