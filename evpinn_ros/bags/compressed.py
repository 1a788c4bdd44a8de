"""Bags that rosbag2 compressed, file by file or message by message, unpacked within limits."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeAlias

import zstandard

from evpinn_ros.bags.mcap_file import McapFile, RawMessage
from evpinn_ros.bags.rosbags_file import RosbagsFile
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import RATIO, check_file, most_unpacked, open_file

_PIECE = 1 << 20

PlainFile: TypeAlias = McapFile | RosbagsFile
BagFile: TypeAlias = "PlainFile | CompressedMessages"


def open_packed(packed: Path, open_plain: Callable[[Path], PlainFile]) -> PlainFile:
    """Unpack a `.zstd` file and open it.

    Raises:
        InputError: it cannot be read, does not unpack, or to more than is allowed.
    """
    # Once it is open, it can be read without its name.
    with TemporaryDirectory() as folder:
        path = Path(folder) / packed.stem
        try:
            with as_input_error(f"{packed}: cannot be unpacked", zstandard.ZstdError):
                _unpack(packed, path)
                file = open_plain(path)
        except InputError as error:
            raise InputError(str(error).replace(str(path), str(packed))) from error
    file.path = packed  # which the person knows
    return file


def _unpack(packed: Path, path: Path) -> None:
    left = most_unpacked(check_file(packed))
    with open_file(packed) as source, path.open("wb") as target:
        reader = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
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
        self._lost = 0

    @property
    def problem(self) -> str | None:
        """Damage and losses, in one line."""
        lost = f"{self.path}: {self._lost} messages do not unpack" if self._lost else None
        return " | ".join(filter(None, (self._file.problem, lost))) or None

    def messages(self, wanted: Container[int]) -> Iterator[RawMessage]:
        """The messages of the wanted channel ids in log time order, unpacked."""
        left = most_unpacked(self.path.stat().st_size)
        for log_time_ns, channel, packed in self._file.messages(wanted):
            try:
                data = unpack_zstd(packed, min(left, most_unpacked(len(packed))))
            except ValueError:
                self._lost += 1
                continue
            left -= len(data)
            yield log_time_ns, channel, data


def unpack_zstd(packed: bytes, most_bytes: int) -> bytes:
    """One zstd frame, or what there is of it, unpacked.

    Raises:
        ValueError: it does not unpack, or to more than `most_bytes`.
    """
    try:
        with zstandard.ZstdDecompressor().stream_reader(packed) as reader:
            data = reader.read(most_bytes + 1)
    except (zstandard.ZstdError, MemoryError) as error:
        raise ValueError(f"not zstd: {error}") from error
    if len(data) > most_bytes:
        raise ValueError(f"unpacks to more than {most_bytes} bytes")
    return data
