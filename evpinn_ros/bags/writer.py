"""Writing rosbag2 bags (MCAP) without ROS, such that a killed recording loses a second at most.

`ros2 bag play`, Foxglove and PlotJuggler open them. A chunk of the file ends when a second of log
time is over, so the same writes give the same bytes.
"""

from __future__ import annotations

import os
from pathlib import Path
import time
from typing import Any

from mcap.writer import CompressionType, Writer

from evpinn_ros.bags.metadata import (
    METADATA,
    WrittenTopic,
    as_yaml,
    bag_information,
    qos_profiles,
    write_metadata,
)
from evpinn_ros.bags.types import encode, typestore
from evpinn_ros.errors import InputError
from evpinn_ros.signals.readings import NANOSECONDS

LIBRARY = "evpinn_ros"  # without a version, which would change the bytes
CHUNK_SECONDS = 1.0  # lost when the process is killed
JUMP_SECONDS = 60.0  # log time that falls back farther was set anew; less is a late message
SYNC_SECONDS = 5.0  # lost when the power is cut


class BagWriter:
    """A bag being written: a context manager, which completes the bag whatever happens in it."""

    def __init__(self, folder: Path | str, *, live: bool = False) -> None:
        """Make the folder, the MCAP file in it and a first metadata.yaml.

        Args:
            folder: the bag; its parents are made too.
            live: end a chunk after a second of wall time as well, for a recording whose log time
                runs slowly or stands; the bytes then depend on the speed of the machine.

        Raises:
            InputError: the folder is in use, or can not be made.
        """
        self.folder = Path(folder)
        _refuse_used(self.folder)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._path = self.folder / f"{self.folder.resolve().name}_0.mcap"
            self._file = self._path.open("xb")
        except OSError as error:
            raise InputError(f"{self.folder}: {error.strerror}") from error
        self._live = live
        self._topics: dict[str, WrittenTopic] = {}
        self._schemas: dict[str, int] = {}
        self._start_ns = self._end_ns = self._chunk_ns = 0
        self._flushed_s = self._synced_s = time.monotonic()
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=LIBRARY)
        self._file.flush()
        self._describe()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Add a message made by `new_message` or read by `BagReader`.

        Raises:
            ValueError: the topic was written with another type before.
        """
        self.write_raw(topic, message.__msgtype__, encode(message), log_time_ns)

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Add the CDR bytes of a message, as a raw subscription of rclpy gives them.

        Raises:
            KeyError: no such type in ROS 2 Jazzy.
            ValueError: the topic was written with another type before.
        """
        written = self._topics.get(topic) or self._add_topic(topic, type_name, log_time_ns)
        if written.type_name != type_name:
            raise ValueError(f"{topic} is {written.type_name}, not {type_name}")
        if self._chunk_is_over(log_time_ns):
            self.flush()
            self._chunk_ns = log_time_ns
        self._writer.add_message(
            written.channel_id, log_time_ns, data, publish_time=log_time_ns, sequence=written.count
        )
        written.count += 1
        self._start_ns = min(self._start_ns, log_time_ns)
        self._end_ns = max(self._end_ns, log_time_ns)

    def flush(self) -> None:
        """Hand all that was written to the operating system; every few seconds to the disk."""
        self._writer.flush()
        self._flushed_s = time.monotonic()
        if self._flushed_s - self._synced_s >= SYNC_SECONDS:
            os.fsync(self._file.fileno())
            self._synced_s = self._flushed_s
        if self._described < len(self._topics):
            self._describe()

    def close(self) -> None:
        """Complete the file and its metadata.yaml; a second call does nothing."""
        if self._file.closed:
            return
        self._writer.flush()
        # rosbag2 looks for this when it is given the bare file.
        self._writer.add_metadata("rosbag2", {"serialized_metadata": as_yaml(self._information())})
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        self._describe()

    def _chunk_is_over(self, log_time_ns: int) -> bool:
        elapsed = (log_time_ns - self._chunk_ns) / NANOSECONDS
        if elapsed >= CHUNK_SECONDS or elapsed <= -JUMP_SECONDS:
            return True
        return self._live and time.monotonic() - self._flushed_s >= CHUNK_SECONDS

    def _add_topic(self, name: str, type_name: str, log_time_ns: int) -> WrittenTopic:
        type_hash = typestore().hash_rihs01(type_name)
        if type_name not in self._schemas:
            definition, _ = typestore().generate_msgdef(type_name, ros_version=2)
            self._schemas[type_name] = self._writer.register_schema(
                type_name, "ros2msg", definition.encode()
            )
        channel_id = self._writer.register_channel(
            name,
            "cdr",
            self._schemas[type_name],
            {"offered_qos_profiles": as_yaml(qos_profiles(name)), "topic_type_hash": type_hash},
        )
        if not self._topics:
            self._start_ns = self._end_ns = self._chunk_ns = log_time_ns
        self._topics[name] = WrittenTopic(name, type_name, type_hash, channel_id)
        return self._topics[name]

    def _describe(self) -> None:
        write_metadata(self.folder, self._information())
        self._described = len(self._topics)

    def _information(self) -> dict[str, Any]:
        return bag_information(
            self._path.name, self._topics.values(), self._start_ns, self._end_ns
        )


def _refuse_used(folder: Path) -> None:
    if folder.is_file():
        raise InputError(f"{folder}: a file is there; a bag is a folder, use another name")
    if not folder.is_dir() or not any(folder.iterdir()):
        return
    if any(any(folder.glob(pattern)) for pattern in (METADATA, "*.mcap", "*.db3")):
        raise InputError(f"{folder}: a bag is there already; use another name or remove it")
    raise InputError(f"{folder}: not empty and not a bag; use another name")
