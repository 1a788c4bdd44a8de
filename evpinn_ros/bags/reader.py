"""Reads bags without ROS: rosbag2 folders, `.mcap` and `.db3`, also compressed or damaged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Container, Iterator
from dataclasses import dataclass
import heapq
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeAlias

import zstandard

from evpinn_ros.bags.channel import Channel, RawMessage
from evpinn_ros.bags.limits import LONGEST_CHUNK, LONGEST_MESSAGE, unpacked, zstd_reader
from evpinn_ros.bags.mcap_file import McapFile
from evpinn_ros.bags.metadata import INFORMATION, METADATA, MOST_METADATA
from evpinn_ros.bags.names import PACKED
from evpinn_ros.bags.sqlite_file import SqliteFile
from evpinn_ros.bags.types import decode, typestore
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import RATIO, check_file, most_unpacked, open_file
from evpinn_ros.common.writer import new_file
from evpinn_ros.common.yaml_section import load_plain

_PIECE = 1 << 20

PlainFile: TypeAlias = McapFile | SqliteFile
BagFile: TypeAlias = "PlainFile | CompressedMessages"


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of a bag: its type `package/msg/Type` and its number of messages."""

    type_name: str
    count: int


class Record(NamedTuple):
    """A message of a bag, or its CDR bytes, and its log time, ns."""

    topic: str
    type_name: str
    log_time_ns: int
    message: Any


class BagReader:
    """An open bag, read in log time order."""

    def __init__(self, path: Path | str) -> None:
        """Open a folder, `.mcap` or `.db3` file; InputError names the file and the reason."""
        self.path = Path(path)  # folder or file
        # messages that `records` left out, by reason: `unknown_type`, `not_cdr`, `too_large`,
        # `undecodable`
        self.dropped: Counter[str] = Counter()
        self._problems: list[str] = []
        self._files = _open(self.path, self._problems)

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        for file in self._files:
            file.close()

    @property
    def topics(self) -> dict[str, TopicInfo]:
        """The topics by name, in the order of their names."""
        infos: dict[str, TopicInfo] = {}
        for file in self._files:
            for id_, channel in file.channels.items():
                before = infos.get(channel.topic, TopicInfo(channel.type_name, 0))
                count = before.count + file.counts.get(id_, 0)
                infos[channel.topic] = TopicInfo(before.type_name, count)
        return dict(sorted(infos.items()))

    @property
    def problem(self) -> str | None:
        """Damage and losses in one line, or None; complete once `records` is exhausted."""
        problems = [*self._problems, *(file.problem for file in self._files if file.problem)]
        return " | ".join(problems) or None

    @property
    def notes(self) -> tuple[str, ...]:
        """A line for each file beside the bag that is not read; no message is lost by it."""
        return tuple(note for file in self._files for note in file.notes)

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        """The messages of `topics` (full names, None for all) in log time order."""
        for raw in self.raw_records(topics):
            try:
                yield Record(*raw[:3], decode(raw.type_name, raw.message))
            except ValueError:
                self.dropped["undecodable"] += 1

    def raw_records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        """`records` with CDR bytes as messages, including those that cannot be decoded."""
        self.dropped.clear()
        streams = [self._raw(file, topics) for file in self._files]
        for log_time_ns, channel, data in heapq.merge(*streams, key=itemgetter(0)):
            if len(data) > LONGEST_MESSAGE:
                self.dropped["too_large"] += 1
                continue
            yield Record(channel.topic, channel.type_name, log_time_ns, data)

    def stored(self) -> Iterator[tuple[int, Channel, bytes]]:
        """Log time, ns, channel and unchanged bytes of every message, in log time order."""

        def messages(file: BagFile) -> Iterator[tuple[int, Channel, bytes]]:
            for log_time_ns, id_, data in file.messages(file.channels):
                yield log_time_ns, file.channels[id_], data

        yield from heapq.merge(*map(messages, self._files), key=itemgetter(0))

    def channels(self) -> set[Channel]:
        """Descriptions of the topics in all files; files may describe a topic differently."""
        return {channel for file in self._files for channel in file.channels.values()}

    def log_times(self) -> Iterator[tuple[str, int]]:
        """Topic and log time, ns, of every message in log time order, even of unknown types."""
        return ((channel.topic, log_time_ns) for log_time_ns, channel, _ in self.stored())

    def _raw(
        self, file: BagFile, topics: Collection[str] | None
    ) -> Iterator[tuple[int, Channel, bytes]]:
        wanted = {}
        for id_, channel in file.channels.items():
            if topics is None or channel.topic in topics:
                if reason := _refusal(channel):
                    self.dropped[reason] += file.counts.get(id_, 0)
                else:
                    wanted[id_] = channel
        for log_time_ns, id_, data in file.messages(wanted):
            yield log_time_ns, wanted[id_], data


def _refusal(channel: Channel) -> str | None:
    if channel.encoding != "cdr":
        return "not_cdr"
    return None if channel.type_name in typestore().fielddefs else "unknown_type"


def _no_bag(folder: Path) -> str:
    inside = sorted(file.parent.name for file in folder.glob(f"*/{METADATA}"))
    hint = f"; there are bags inside it: {', '.join(inside[:5])}" if inside else ""
    return f"{folder}: no .mcap or .db3 file in this folder{hint}"


def _open(path: Path, problems: list[str]) -> list[BagFile]:
    """Open the files of a bag; adds missing, unread and unreadable files to `problems`."""
    if not path.is_dir():
        return [_open_alone(path, problems)]
    if (path / METADATA).exists():
        check_file(path / METADATA)  # a pipe is an error, not damage
    metadata = _metadata(path / METADATA, problems)
    mode = _mode(metadata)
    paths, others = _files(path, "mcap"), _files(path, "db3")
    if paths and others:
        names = ", ".join(other.name for other in others)
        problems.append(f"{path}: MCAP files are read, not {names}; give such a file by its name")
    paths = paths or others
    listed = _listed(metadata)
    there = {file.name.removesuffix(PACKED) for file in paths}
    if missing := sorted(name for name in listed if name.removesuffix(PACKED) not in there):
        problems.append(f"{path}: {METADATA} lists missing files: {', '.join(missing)}")
    files: list[BagFile] = []
    errors: list[InputError] = []
    for file in paths:
        try:
            files.append(_open_compressed(file, mode))
        except InputError as error:
            errors.append(error)
    if not files:
        raise errors[0] if errors else InputError(_no_bag(path))
    problems.extend(str(error) for error in errors)
    return files


def _open_alone(path: Path, problems: list[str]) -> BagFile:
    """Open one file of a bag, unpacked as the metadata.yaml next to it states."""
    metadata = _metadata(path.with_name(METADATA), [])
    listed = _listed(metadata)
    if path.name not in listed:
        return _open_compressed(path, "")
    if len(listed) > 1:
        problems.append(f"{path}: one of {len(listed)} files of its bag; give the folder for all")
    return _open_compressed(path, _mode(metadata))


def _mode(metadata: dict[str, Any]) -> str:
    return str(metadata.get("compression_mode")).lower()


def _listed(metadata: dict[str, Any]) -> set[str]:
    """Listed file names without their paths: only files in the folder are opened."""
    return {Path(str(name)).name for name in metadata.get("relative_file_paths") or ()}


def _files(folder: Path, storage: str) -> list[Path]:
    """Files of a storage by name, with files that a power loss left uncompressed."""
    files = {path.stem: path for path in folder.glob(f"*.{storage}{PACKED}")}
    files |= {path.name: path for path in folder.glob(f"*.{storage}")}
    return [files[name] for name in sorted(files)]


def _open_compressed(path: Path, mode: str) -> BagFile:
    if path.suffix == PACKED:
        return _open_packed(path)
    return CompressedMessages(_open_file(path), path) if mode == "message" else _open_file(path)


def _open_file(path: Path) -> PlainFile:
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty")
    if path.suffix == ".db3":
        return SqliteFile(path)
    return McapFile(path)


def _metadata(path: Path, problems: list[str]) -> dict[str, Any]:
    if not path.exists():
        return {}
    try:
        document = load_plain(path, "bag metadata", MOST_METADATA)
    except InputError as error:
        problems.append(f"{error}; it is ignored")
        return {}
    information = document.get(INFORMATION) if isinstance(document, dict) else None
    if isinstance(information, dict) and isinstance(information.get("relative_file_paths"), list):
        return information
    problems.append(f"{path}: lists no files; it is ignored")
    return {}


def _open_packed(packed: Path) -> PlainFile:
    # An open file stays readable after its folder is deleted.
    with TemporaryDirectory() as folder:
        path = Path(folder) / packed.stem
        try:
            with as_input_error(f"{packed}: cannot be unpacked", zstandard.ZstdError):
                _unpack(packed, path)
                file = _open_file(path)
        except InputError as error:
            raise InputError(str(error).replace(str(path), str(packed))) from error
    file.path = packed  # the name that the user knows
    return file


def _unpack(packed: Path, path: Path) -> None:
    left = most_unpacked(check_file(packed))
    with open_file(packed) as source, new_file(path) as target:
        reader = zstd_reader(source)
        while piece := reader.read(_PIECE):
            left -= len(piece)
            if left < 0:
                raise InputError(f"{packed}: unpacks to over {RATIO} times its size")
            target.write(piece)


class CompressedMessages:
    """A file whose messages are compressed one by one."""

    def __init__(self, file: PlainFile, path: Path) -> None:
        self._file, self.path = file, path
        self.channels, self.counts, self.close = file.channels, file.counts, file.close
        self.notes = file.notes
        self._lost = 0

    @property
    def problem(self) -> str | None:
        """Damage and losses, in one line."""
        lost = f"{self.path}: {self._lost} messages cannot be unpacked" if self._lost else None
        return " | ".join(filter(None, (self._file.problem, lost))) or None

    def messages(self, wanted: Container[int]) -> Iterator[RawMessage]:
        """The messages of the wanted channel ids in log time order, unpacked."""
        left = most_unpacked(self.path.stat().st_size)
        for log_time_ns, channel, packed in self._file.messages(wanted):
            try:
                data = unpacked(
                    "zstd", packed, min(left, most_unpacked(len(packed)), LONGEST_CHUNK)
                )
            except ValueError:
                self._lost += 1
                continue
            left -= len(data)
            yield log_time_ns, channel, data
