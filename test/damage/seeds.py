"""Sound inputs of every format, made by code: what a fuzzer starts to damage."""

from __future__ import annotations

from collections.abc import Iterable
import gzip
from io import BytesIO
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import can
from mcap.writer import CompressionType, IndexType, Writer
import polars as pl
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
import zstandard

from evpinn_ros import topics
from evpinn_ros.bags.types import encode, new_message, typestore
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.energy.power_model import vehicle_model
from evpinn_ros.core.signals import readings
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.topics.messages import header, scalar
from evpinn_ros.topics.model import model_message
from evpinn_ros.topics.plans import DISTANCE_JOINT
from evpinn_ros.topics.readings import reading_message, speed_message
from test.logs.plans import samples

VEHICLE = "tesla_model_3_lr"
START = 1_700_000_000 * NANOSECONDS
STEP = NANOSECONDS // 10
READINGS: tuple[Reading, ...] = (
    SpeedReading(START, 10.0),
    readings.BatteryReading(START, 350.0, -20.0, 0.5),
    readings.GradeReading(START, 0.01),
    readings.AltitudeReading(START, 300.0),
    readings.TemperatureReading(START, 12.0),
    readings.PressureReading(START, 98e3),
    readings.WindReading(START, 2.0),
    readings.AuxiliaryReading(START, 500.0, 100.0),
    readings.MotorReading(START, 80.0, 400.0),
)
"""One of each kind; the place in here chooses the type of a fuzzed message."""


def mcap_files() -> list[bytes]:
    """MCAP files as other programs write them: compressions, without index, without chunks."""
    options: list[dict[str, Any]] = [
        {},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE, "index_types": IndexType.NONE},
        {"use_chunking": False},
    ]
    return [
        _file("drive.mcap", lambda path, written=written: _mcap(path, written))
        for written in options
    ]


def database() -> list[bytes]:
    """A sqlite3 bag of rosbags."""
    return [_bag_file(StoragePlugin.SQLITE3, "*.db3")]


def packed_file() -> list[bytes]:
    """An MCAP file as rosbag2 compresses it."""
    return [zstandard.ZstdCompressor().compress(mcap_files()[3])]


def metadata() -> list[bytes]:
    """The metadata.yaml of a compressed bag."""
    mode = (CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    return [_bag_file(StoragePlugin.MCAP, "metadata.yaml", mode)]


def can_log(suffix: str) -> list[bytes]:
    """A CAN log of a drive, written by python-can."""

    def write(path: Path) -> None:
        with can.Logger(str(path)) as logger:
            for index in range(40):
                logger.on_message_received(
                    can.Message(
                        timestamp=1.5e9 + index / 100,
                        arbitration_id=0x132 if index % 2 else 0x18FF0001,
                        is_extended_id=not index % 2,
                        data=index.to_bytes(index % 8 + 1, "little"),
                    )
                )

    return [_file(f"drive{suffix}", write)]


def zipped_log() -> list[bytes]:
    """A gzipped candump log."""
    return [gzip.compress(log, mtime=0) for log in can_log(".log")]


def bundled(pattern: str) -> list[bytes]:
    """The files of a kind that come with the package."""
    return [path.read_bytes() for path in sorted((share_directory() / "config").glob(pattern))]


def csv_drive() -> list[bytes]:
    """A drive as `evpinn convert` takes it."""
    rows = (f"{i / 10},{i / 5},{350 - i},{20 + i},,300.5,12,500,0" for i in range(30))
    columns = "t_s,speed_mps,voltage_v,current_a,power_w,elevation_m,ambient_c,heating_w,aircon_w"
    return ["\n".join((columns, *rows)).encode()]


def zipped_drive() -> list[bytes]:
    """A gzipped table of a drive."""
    return [gzip.compress(table, mtime=0) for table in csv_drive()]


def workbooks() -> list[bytes]:
    """A workbook of openpyxl, of the extra `tables`."""
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    sheet = book.create_sheet("drive")
    for line in csv_drive()[0].decode().splitlines():
        sheet.append(line.split(","))
    book.save(file := BytesIO())
    return [file.getvalue()]


def parquet_files() -> list[bytes]:
    """Parquet of polars, in three compressions."""
    files = []
    for compression in ("zstd", "snappy", "uncompressed"):
        table = pl.read_csv(csv_drive()[0])
        table.write_parquet(file := BytesIO(), compression=compression)
        files.append(file.getvalue())
    return files


def json_lines() -> list[bytes]:
    """A drive as lines of JSON."""
    return [pl.read_csv(csv_drive()[0]).write_ndjson().encode()]


def json_document() -> list[bytes]:
    """A drive as a list in a document of JSON."""
    return [b'{"samples":' + pl.read_csv(csv_drive()[0]).write_json().encode() + b"}"]


def feather_files() -> list[bytes]:
    """A drive as a Feather file."""
    pl.read_csv(csv_drive()[0]).write_ipc(file := BytesIO(), compression="lz4")
    return [file.getvalue()]


def broker_messages() -> list[bytes]:
    """Topics, payloads and flags of messages of a broker, with the seconds between them."""
    base, rows = "ovms/me/CAR/metric/v/", []
    for second in range(15):
        values = {"p/speed": 36 + second, "b/voltage": 350.5, "b/current": 20, "b/soc": 80}
        values |= {"e/on": "yes", "p/altitude": 300, "e/temp": 12, "b/power": 7}
        rows += [[base + name, str(value), second < 2, 1] for name, value in values.items()]
    return as_json(rows)


def plan_files() -> list[bytes]:
    """A track, and an answer of each route service; their content tells them apart."""
    point = '<trkpt lat="48.%d" lon="11"><ele>5</ele><time>2024-05-01T10:%d:00Z</time></trkpt>'
    track = "".join(point % (i, i) for i in range(10, 30))
    place = {"type": "LineString", "coordinates": [[11, 48, 5], [11, 48.1, 9]]}
    answers = (
        *(samples.valhalla(), samples.valhalla_edges(), samples.osrm(), samples.osrm(steps=False)),
        *(samples.graphhopper(("time", "average_speed")), samples.openrouteservice()),
        samples.openrouteservice("geojson"),
        {"type": "Feature", "properties": {"times": [0, 900]}, "geometry": place},
    )
    texts = (json.dumps(answer) for answer in answers)
    return [plan.encode() for plan in (f"<gpx><trk>{track}</trk></gpx>", *texts)]


def plan_tables() -> list[bytes]:
    """Speed over time, and legs."""
    speeds = b"t_s,speed_mps,elevation_m\n0,0,5\n9,20,6\n90,20,9\n"
    return [speeds, b"length_km,duration_min,climb_m\n1.2,2,9\n0,1,\n"]


def truth() -> list[bytes]:
    """The truth beside a simulated drive."""
    numbers = {"eta": 0.9, "mu": 0.6, "mass": 1850.0, "c_rr": 0.01, "c_d": 0.23, "p_aux": 400.0}
    return ["\n".join(("parameters:", *(f"  {k}: {v}" for k, v in numbers.items()))).encode()]


def as_json(state: Any) -> list[bytes]:
    """A saved state."""
    return [json.dumps(state).encode()]


def messages() -> list[bytes]:
    """A message of each input, its place in `READINGS` before it."""
    made = (encode(reading_message(new_message, reading)) for reading in READINGS)
    return [bytes((place,)) + data for place, data in enumerate(made)]


def model() -> list[bytes]:
    """The model of a car."""
    car = vehicle_model(load_vehicle(VEHICLE)).car
    return [encode(model_message(new_message, VEHICLE, car))]


def plans() -> list[bytes]:
    """A path and a speed profile, 0 or 1 before it."""
    stamps = [header(new_message, START + second * NANOSECONDS) for second in range(6)]
    poses = [_pose(stamp, 10.0 * second) for second, stamp in enumerate(stamps)]
    path = new_message(topics.PATH_TYPE, header=stamps[0], poses=poses)
    points = [
        new_message(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=[10.0 * second],
            velocities=[10.0],
            time_from_start=new_message("builtin_interfaces/msg/Duration", sec=second, nanosec=0),
        )
        for second in range(6)
    ]
    profile = new_message(
        topics.TRAJECTORY_TYPE, header=stamps[0], joint_names=[DISTANCE_JOINT], points=points
    )
    return [b"\0" + encode(path), b"\1" + encode(profile)]


def frames() -> list[bytes]:
    """Frames in a row, each as its id, its length and its data, and answers in parts."""
    seen = [(0x132, 8), (0x257, 8), (0x118, 8), (0x1DB, 8), (0x1DA, 8), (0x355, 8)]
    answers = [
        (0x7EC, bytes.fromhex(digits)) for digits in ("101462010100FFFF", "2100000000000000")
    ]
    whole = [(can_id, bytes(range(length))) for can_id, length in seen] + answers
    return [b"".join(_framed(can_id, data) for can_id, data in whole * 3)]


def _framed(can_id: int, data: bytes) -> bytes:
    return can_id.to_bytes(4, "big") + bytes((len(data),)) + data


def _pose(stamped: Any, x: float) -> Any:
    position = new_message("geometry_msgs/msg/Point", x=x, y=0.0, z=0.0)
    pose = new_message("geometry_msgs/msg/Pose", position=position)
    return new_message("geometry_msgs/msg/PoseStamped", header=stamped, pose=pose)


def _mcap(path: Path, options: dict[str, Any]) -> None:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2000, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema(topics.SPEED_TYPE, "ros2msg", b"float64 data")
        channel = writer.register_channel("/ev/vehicle/speed", "cdr", schema)
        for stamp, data in _speeds():
            writer.add_message(channel, stamp, data, stamp)
        writer.finish()


def _speeds() -> Iterable[tuple[int, bytes]]:
    stamps = (START + index * STEP for index in range(20))
    return [(t, encode(speed_message(new_message, SpeedReading(t, 10.0)))) for t in stamps]


def _bag_file(plugin: StoragePlugin, pattern: str, compression: Any = None) -> bytes:
    def write(folder: Path) -> None:
        writer = RosbagsWriter(folder, version=9, storage_plugin=plugin)
        if compression is not None:
            writer.set_compression(*compression)
        with writer:
            add = writer.add_connection
            speed = add("/ev/vehicle/speed", topics.SPEED_TYPE, typestore=typestore())
            plain = add("/ev/battery/voltage", topics.SCALAR_TYPE, typestore=typestore())
            for stamp, data in _speeds():
                writer.write(speed, stamp, data)
                writer.write(plain, stamp, encode(scalar(new_message, 350.0)))

    return _file("bag", write, pattern)


def _file(name: str, write: Any, pattern: str = "") -> bytes:
    """The bytes of what a function writes, of a file in it if it is a folder."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path)
        return (next(path.glob(pattern)) if pattern else path).read_bytes()
