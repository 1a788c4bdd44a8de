"""Writes rosbag2 bags (MCAP) without ROS; a killed recording loses a second at most.

A chunk holds a second of log time, so the same writes give the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
import os
from pathlib import Path
from shutil import rmtree
import threading
import time
from typing import Any

from mcap.writer import CompressionType, Writer

from evpinn_ros.bags.metadata import (
    METADATA,
    WrittenFile,
    WrittenTopic,
    as_yaml,
    bag_information,
    qos_profiles,
    write_metadata,
)
from evpinn_ros.bags.types import encode, typestore
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.writer import new_file, sync
from evpinn_ros.core.signals.readings import NANOSECONDS

LIBRARY = "evpinn_ros"  # without a version, which would change the bytes
CHUNK_SECONDS = 1.0  # of log time in a chunk, which a kill loses
JUMP_SECONDS = 60.0  # larger steps back mean that log time was reset; smaller ones, a late message
SYNC_SECONDS = 0.4  # between syncs to the disk; a power loss loses this and the time of a sync


@dataclass(frozen=True, slots=True)
class Split:
    """Limits at which a bag continues in another file."""

    # bytes at which a file is full; the chunk that fills it still belongs to it
    size: float = math.inf
    seconds: float = math.inf  # of log time in a file at most


class BagWriter:
    """A bag being written: a context manager that completes the bag even after an exception."""

    def __init__(
        self, folder: Path | str, *, live: bool = False, split: Split | None = None
    ) -> None:
        """Create the folder, the MCAP file and a first metadata.yaml; InputError if it cannot.

        `live` ends a chunk after a second of wall time too; `split` says when another file begins.
        """
        self.folder = Path(folder)
        _refuse_used(self.folder)
        self._live, self._split = live, split or Split()
        self._topics: dict[str, WrittenTopic] = {}
        self._files: list[WrittenFile] = []
        there = self.folder.is_dir()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._part = self._begin_part()
            self._describe()
        except OSError as error:
            rmtree(self.folder, ignore_errors=True)
            if there:
                self.folder.mkdir(exist_ok=True)
            raise InputError(f"{self.folder}: {error.strerror}") from error
        if live:
            for parent in self.folder.resolve().parents:  # some may be new
                sync(parent)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Add a message made by `new_message` or read by `BagReader`."""
        self.write_raw(topic, message.__msgtype__, encode(message), log_time_ns)

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Add a message's CDR bytes; KeyError: unknown type, ValueError: the topic has another."""
        written = self._topics.get(topic) or self._add_topic(topic, type_name)
        if written.type_name != type_name:
            raise ValueError(f"{topic} is {written.type_name}, not {type_name}")
        if self._chunk_is_over(log_time_ns):
            self._part.end_chunk(log_time_ns)
            self._described_all()
        if self._is_full(log_time_ns):
            self._part.close(self._information())
            self._part = self._begin_part()
            self._describe()
        self._part.write(written, data, log_time_ns)
        written.count += 1

    def flush(self) -> None:
        """Flush to the operating system, and every `SYNC_SECONDS` to the disk."""
        self._part.flush()
        self._described_all()

    def close(self) -> None:
        """Complete the file and its metadata.yaml; a second call does nothing."""
        self._part.close(self._information())
        self._describe()
        sync(self.folder / METADATA)
        sync(self.folder)

    def _chunk_is_over(self, log_time_ns: int) -> bool:
        if self._part.chunk_is_over(log_time_ns):
            return True
        return self._live and time.monotonic() - self._part.flushed_s >= CHUNK_SECONDS

    def _is_full(self, log_time_ns: int) -> bool:
        file = self._part.written
        if not file.count:
            return False
        elapsed = (log_time_ns - file.start_ns) / NANOSECONDS
        return elapsed >= self._split.seconds or self._part.size >= self._split.size

    def _begin_part(self) -> McapPart:
        name = f"{self.folder.resolve().name}_{len(self._files)}.mcap"
        part = McapPart(self.folder / name)
        self._files.append(part.written)
        return part

    def _add_topic(self, name: str, type_name: str) -> WrittenTopic:
        type_hash = typestore().hash_rihs01(type_name)
        self._topics[name] = WrittenTopic(name, type_name, type_hash, qos_profiles(name))
        return self._topics[name]

    def _described_all(self) -> None:
        if self._described < len(self._topics):
            self._describe()

    def _describe(self) -> None:
        write_metadata(self.folder, self._information())
        self._described = len(self._topics)

    def _information(self) -> dict[str, Any]:
        return bag_information(self._files, self._topics.values())


def _refuse_used(folder: Path) -> None:
    if folder.is_file():
        raise InputError(f"{folder}: a file is there; a bag is a folder, use another name")
    if not folder.is_dir() or not any(folder.iterdir()):
        return
    if any(any(folder.glob(pattern)) for pattern in (METADATA, "*.mcap", "*.db3")):
        raise InputError(f"{folder}: a bag is there already; use another name or remove it")
    raise InputError(f"{folder}: not empty and not a bag; use another name")


class McapPart:
    """An open MCAP file in chunks of a second of log time."""

    def __init__(self, path: Path) -> None:
        self.written = WrittenFile(path.name)  # its message count and log times
        self._folder = path.parent
        self._file = new_file(path)
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
        """Add a message; its sequence number counts the topic's messages over all files."""
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
        self.written.add(log_time_ns)

    def chunk_is_over(self, log_time_ns: int) -> bool:
        """True if a message at this log time begins a new chunk."""
        if not self.written.count:
            return False
        elapsed = (log_time_ns - self._chunk_ns) / NANOSECONDS
        return elapsed >= CHUNK_SECONDS or elapsed <= -JUMP_SECONDS

    def end_chunk(self, next_ns: int) -> None:
        """Flush; the next chunk begins at `next_ns`."""
        self.flush()
        self._chunk_ns = next_ns

    def flush(self) -> None:
        """Flush to the operating system; OSError, also of an earlier sync."""
        self._writer.flush()
        self.flushed_s = time.monotonic()
        if self._problem is not None:
            raise self._problem
        idle = self._syncing is None or not self._syncing.is_alive()
        if idle and self.flushed_s - self._synced_s >= SYNC_SECONDS:
            # In a thread: a card may take a second, while the car drives on.
            self._syncing = threading.Thread(target=self._sync, daemon=True)
            self._syncing.start()
            self._synced_s = self.flushed_s

    def _sync(self) -> None:
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            self._problem = error
        sync(self._folder)  # makes the name of a new file durable

    def close(self, information: Any) -> None:
        """Complete the file with the content of metadata.yaml; a second call does nothing."""
        if self._file.closed:
            return
        if self._syncing is not None:
            self._syncing.join()
        self._writer.flush()
        # rosbag2 reads this when it opens the file without its folder.
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
