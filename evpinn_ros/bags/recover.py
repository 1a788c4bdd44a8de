"""`evpinn recover`: saves the readable part of a broken bag as a new one; reports losses."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
import os
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Message
from mcap.writer import Writer

from evpinn_ros.bags.mcap_records import Loss, McapItem, McapRecords
from evpinn_ros.bags.metadata import (
    METADATA,
    WrittenFile,
    WrittenTopic,
    as_yaml,
    bag_information,
    write_metadata,
)
from evpinn_ros.bags.writer import LIBRARY
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import open_file
from evpinn_ros.common.writer import new_file
from evpinn_ros.common.yaml_section import plain_text

MOST_LOSSES = 1000  # listed one by one; later losses are only counted
LONGEST_QOS = 10_000  # characters of YAML that are read
ROSBAG2 = "rosbag2"  # name of the metadata record that is rewritten

Progress = Callable[[int], None]  # called with the bytes read so far


@dataclass(slots=True)
class RecoveredFile:
    """Result of recovering one file."""

    path: Path  # of the broken file
    size: int = 0  # bytes of that file
    messages: int = 0  # saved
    unproven: int = 0  # saved messages without a checksum
    stated: int | None = None  # messages by the file's own count; None if it has none
    ended: bool = False  # True if the file has its end and index
    unknown_topic: int = 0  # messages omitted because the definition of their topic is lost
    start_ns: int = 0  # first log time saved; zero without a message
    end_ns: int = 0  # last log time saved
    losses: list[Loss] = field(default_factory=list)  # the first `MOST_LOSSES`, in file order
    more_losses: int = 0  # losses beyond these
    lost_bytes: int = 0  # of all losses
    problem: str | None = None  # why it could not be read to its end; None if it could

    @property
    def lost_chunks(self) -> int:
        """Chunks that were damaged, cut or refused."""
        return sum(loss.chunk for loss in self.losses)

    @property
    def lost_messages(self) -> int | None:
        """Number of messages not saved; None if unknown."""
        if self.stated is not None:
            return max(0, self.stated - self.messages)
        counts = [loss.messages for loss in self.losses]
        if self.problem or self.more_losses or None in counts:
            return None
        return sum(count or 0 for count in counts) + self.unknown_topic

    @property
    def whole(self) -> bool:
        """True if no message was lost; the index may be."""
        if self.problem or self.unknown_topic or self.more_losses:
            return False
        return self.lost_messages == 0 if self.stated is not None else not self.losses

    def count(self, log_time_ns: int, written: WrittenFile, proven: bool) -> None:
        """Count a saved message."""
        self.messages, self.unproven = written.count, self.unproven + (not proven)
        self.start_ns, self.end_ns = written.start_ns, written.end_ns
        for loss in reversed(self.losses):
            if loss.before_ns is not None:
                break
            loss.before_ns = log_time_ns

    def note(self, loss: Loss) -> None:
        """Add a loss that follows the messages saved so far."""
        loss.after_ns = self.end_ns if self.messages else None
        self.lost_bytes += loss.end - loss.begin
        if len(self.losses) == MOST_LOSSES:
            self.more_losses += 1
        else:
            self.losses.append(loss)


def recover(source: Path, out: Path, progress: Progress = lambda _: None) -> list[RecoveredFile]:
    """Save the readable messages of an MCAP file, or of a folder of them, as a new bag.

    `progress` gets the bytes read so far. An interrupted call removes its files. InputError: no
    MCAP, `out` is not empty, or no message could be saved. OSError: `out` cannot be written.
    """
    paths = broken_files(source)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: exists and is not empty; give the name of a new folder")
    out.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    try:
        recovered = _recover_files(paths, out, files, progress)
        if not files:
            raise InputError(_nothing(source, recovered))
        return recovered
    except (InputError, OSError, KeyboardInterrupt):
        for path in (*files, out / METADATA):
            path.unlink(missing_ok=True)
        with suppress(OSError):  # not empty: another process writes there too
            out.rmdir()
        raise


def _recover_files(
    paths: list[Path], out: Path, files: list[Path], progress: Progress
) -> list[RecoveredFile]:
    """Save each of `paths`; written files are added to `files`."""
    recovered: list[RecoveredFile] = []
    topics: dict[str, WrittenTopic] = {}
    written: list[WrittenFile] = []
    for path in paths:
        files.append(out / f"{out.resolve().name}_{len(files)}.mcap")
        before = sum(file.size for file in recovered)
        with _Copy(files[-1], topics) as copy:
            recovered.append(_recover_file(path, copy, progress, before))
        if copy.written.count:
            written.append(copy.written)
        else:
            files.pop().unlink()
    if files:
        write_metadata(out, bag_information(written, topics.values()))
    return recovered


def _nothing(source: Path, files: list[RecoveredFile]) -> str:
    for file in files:
        if file.problem is not None:
            return file.problem
    empty = not any(file.size for file in files)
    return f"{source}: {'the file is empty' if empty else 'no message could be saved'}"


def broken_files(source: Path) -> list[Path]:
    """The MCAP files of a bag, in the order of their numbers; InputError if none."""
    if not source.exists():
        raise InputError(f"{source}: no such file or folder")
    if source.is_file():
        return [source]
    if not source.is_dir():
        raise InputError(f"{source}: neither a file nor a folder")
    paths = [path for path in source.glob("*.mcap") if path.is_file()]
    if not paths:
        advice = (
            "recover a sqlite3 bag by: sqlite3 BAG.db3 .recover"
            if any(source.glob("*.db3"))
            else "give the folder of a rosbag2 bag, or an MCAP file"
        )
        raise InputError(f"{source}: no .mcap file in this folder; {advice}")
    return sorted(paths, key=lambda path: (_number(path), path.name))


def _number(path: Path) -> int:
    """Number in the name of a bag's file, -1 if none: drive_10 comes after drive_9."""
    digits = path.stem.rpartition("_")[2]
    return int(digits) if digits.isascii() and digits.isdigit() else -1


def _recover_file(path: Path, copy: _Copy, progress: Progress, before: int) -> RecoveredFile:
    report = RecoveredFile(path)
    try:
        with as_input_error(path):
            file = open_file(path)
    except InputError as error:
        report.problem = str(error)
        return report
    with file:
        records = McapRecords(file, path)
        report.size = records.size
        try:
            bytes_done = 0
            for item in records:
                _save(item, records, report, copy)
                if records.position > bytes_done:
                    bytes_done = records.position
                    progress(before + bytes_done)
        except InputError as error:
            report.problem = str(error)
        report.stated, report.ended = records.stated, records.ended
        report.unknown_topic = records.unknown
        copy.finish()
        return report


def _save(item: McapItem, records: McapRecords, report: RecoveredFile, copy: _Copy) -> None:
    if isinstance(item, Loss):
        report.note(item)
    elif isinstance(item, Message):
        copy.add(item, records)
        report.count(item.log_time, copy.written, records.proven)
    elif isinstance(item, Attachment):
        copy.writer.add_attachment(
            item.create_time, item.log_time, item.name, item.media_type, item.data
        )
    elif item.name != ROSBAG2:
        copy.writer.add_metadata(item.name, item.metadata)


class _Copy:
    def __init__(self, path: Path, topics: dict[str, WrittenTopic]) -> None:
        self.written = WrittenFile(path.name)  # number and log times of its messages
        self._topics = topics
        self._ids: dict[int, tuple[int, WrittenTopic]] = {}  # new id and topic by the old id
        self._schemas = {0: 0}  # new ids by the old ones
        with as_input_error(path):
            self._file = new_file(path)
        self.writer = Writer(self._file)  # of the mcap library
        # ROS 2 readers refuse any other profile; the types are in the schemas.
        self.writer.start(profile="ros2", library=LIBRARY)

    def __enter__(self) -> _Copy:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, message: Message, records: McapRecords) -> None:
        """Add a message, and the definition of its topic before its first one."""
        if message.channel_id not in self._ids:
            self._ids[message.channel_id] = self._define(message.channel_id, records)
        channel_id, topic = self._ids[message.channel_id]
        self.writer.add_message(
            channel_id, message.log_time, message.data, message.publish_time, message.sequence
        )
        topic.count += 1
        self.written.add(message.log_time)

    def finish(self) -> None:
        """Complete the file, with the metadata that rosbag2 reads, and sync it to the disk."""
        information = bag_information([self.written], self._topics.values())
        self.writer.add_metadata(ROSBAG2, {"serialized_metadata": as_yaml(information)})
        self.writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())

    def _define(self, old_id: int, records: McapRecords) -> tuple[int, WrittenTopic]:
        channel = records.channels[old_id]
        schema = records.schemas.get(channel.schema_id)
        if schema is not None and schema.id not in self._schemas:
            self._schemas[schema.id] = self.writer.register_schema(
                schema.name, schema.encoding, schema.data
            )
        new_id = self.writer.register_channel(
            channel.topic,
            channel.message_encoding,
            self._schemas[channel.schema_id],
            channel.metadata,
        )
        if channel.topic not in self._topics:
            type_hash = channel.metadata.get("topic_type_hash", "")
            type_name = schema.name if schema is not None else ""
            topic = WrittenTopic(channel.topic, type_name, type_hash, _qos(channel))
            self._topics[channel.topic] = topic
        return new_id, self._topics[channel.topic]


def _qos(channel: Channel) -> list[dict[str, Any]]:
    """Offered QoS as in the file: rosbags reads a topic only if metadata.yaml agrees with it."""
    text = channel.metadata.get("offered_qos_profiles", "")
    if len(text) > LONGEST_QOS:
        return []
    try:
        document = plain_text(text)
    except ValueError:
        return []
    whole = isinstance(document, list) and all(isinstance(profile, dict) for profile in document)
    return document if whole else []
