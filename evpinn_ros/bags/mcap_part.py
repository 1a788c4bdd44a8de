"""One MCAP file of a bag that is being written."""

from __future__ import annotations

import os
from pathlib import Path
import threading
import time
from typing import Any

from mcap.writer import CompressionType, Writer

from evpinn_ros.bags.metadata import WrittenFile, WrittenTopic, as_yaml
from evpinn_ros.bags.types import typestore
from evpinn_ros.common.writer import sync
from evpinn_ros.signals.readings import NANOSECONDS

LIBRARY = "evpinn_ros"  # without a version, which would change the bytes
CHUNK_SECONDS = 1.0  # lost when the process is killed
JUMP_SECONDS = 60.0  # log time that falls back farther was set anew; less is a late message
SYNC_SECONDS = 0.4  # between two writings to the disk, and the time of one is lost with the power


class McapPart:
    """An open file; a chunk ends when a second of log time is over.

    Attributes:
        written: what is in it.
        flushed_s: when that was last handed to the operating system, by the monotonic clock.
    """

    def __init__(self, path: Path) -> None:
        """Make the file.

        Raises:
            OSError: it is there, or cannot be made.
        """
        self.written = WrittenFile(path.name)
        self._folder = path.parent
        self._file = path.open("xb")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._chunk_ns = 0
        self.flushed_s = self._synced_s = time.monotonic()
        self._syncing: threading.Thread | None = None
        self._problem: OSError | None = None
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=LIBRARY)
        self._file.flush()

    @property
    def size(self) -> int:
        """Bytes in the file, without the chunk that is still open."""
        return self._file.tell()

    def write(self, topic: WrittenTopic, data: bytes, log_time_ns: int) -> None:
        """Add a message; its number is that of the topic, over all files."""
        if topic.name not in self._channels:
            self._channels[topic.name] = self._add_channel(topic)
        if not self.written.count:
            self._chunk_ns = log_time_ns
        self._writer.add_message(
            self._channels[topic.name],
            log_time_ns,
            data,
            publish_time=log_time_ns,
            sequence=topic.count,
        )
        self.written.add(log_time_ns, log_time_ns, 1)

    def chunk_is_over(self, log_time_ns: int) -> bool:
        """True if a message of this time begins another chunk."""
        if not self.written.count:
            return False
        elapsed = (log_time_ns - self._chunk_ns) / NANOSECONDS
        return elapsed >= CHUNK_SECONDS or elapsed <= -JUMP_SECONDS

    def end_chunk(self, next_ns: int) -> None:
        """Flush; the next chunk begins at this log time."""
        self.flush()
        self._chunk_ns = next_ns

    def flush(self) -> None:
        """Hand all that was written to the operating system, which begins to put it on the disk.

        Raises:
            OSError: this failed, or an earlier write.
        """
        self._writer.flush()
        self.flushed_s = time.monotonic()
        if self._problem is not None:
            raise self._problem
        idle = self._syncing is None or not self._syncing.is_alive()
        if idle and self.flushed_s - self._synced_s >= SYNC_SECONDS:
            # Beside: a card may take a second, in which the car drives on.
            self._syncing = threading.Thread(target=self._sync, daemon=True)
            self._syncing.start()
            self._synced_s = self.flushed_s

    def _sync(self) -> None:
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            self._problem = error
        sync(self._folder)  # a new file has a name there only once this is done

    def close(self, information: Any) -> None:
        """Complete the file, with what metadata.yaml says of it; a second call does nothing."""
        if self._file.closed:
            return
        if self._syncing is not None:
            self._syncing.join()
        self._writer.flush()
        # rosbag2 looks for this when it is given the bare file.
        self._writer.add_metadata("rosbag2", {"serialized_metadata": as_yaml(information)})
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()

    def _add_channel(self, topic: WrittenTopic) -> int:
        name = topic.type_name
        if name not in self._schemas:
            definition, _ = typestore().generate_msgdef(name, ros_version=2)
            self._schemas[name] = self._writer.register_schema(
                name, "ros2msg", definition.encode()
            )
        channel: int = self._writer.register_channel(
            topic.name,
            "cdr",
            self._schemas[name],
            {"offered_qos_profiles": as_yaml(topic.qos), "topic_type_hash": topic.type_hash},
        )
        return channel
