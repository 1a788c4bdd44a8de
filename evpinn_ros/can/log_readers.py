"""Readers of logs that python-can does not read, or trusts too much, in its own form.

Vector's .blf logs may come from anywhere, and python-can trusts every length that a damaged one
claims. CSV logs of SavvyCAN and of GVRET firmware hold a frame a row, hexadecimal:
`Time Stamp,ID,Extended,Dir,Bus,LEN,D1,...,D8`, times in microseconds; version 1 has no `Dir`
(SavvyCAN, framefileio.cpp, loadNativeCSVFile).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import csv
import logging
import struct
from typing import IO, Any
import zlib

import can

MICROSECOND = 1e-6

# Bytes of a log that are read or kept at once. Vector's and python-can's containers hold 128 KB;
# deflate makes a thousand times as much of zeros, and an object can claim to go on for ever.
LARGEST_OBJECT = 512 << 10

_MARK = b"LOBJ"
_OBJECT = struct.Struct("<4sHHII")  # mark, size and version of the header, size, type
_PADDING = 4
_CONTAINER, _STORED, _DEFLATED = 10, 0, 2  # an object of objects, and how it is packed
_METHOD = struct.Struct("<H14x")

# It would say the same of each object of a damaged log; `LogFile.problem` says it once.
logging.getLogger("can.io.blf").setLevel(logging.ERROR)


class BlfReader(can.BLFReader):  # type: ignore[misc]  # python-can has types but no marker
    """Reads a log and raises ValueError where an object is too large or has no size at all."""

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__(_Bounded(file))

    def __iter__(self) -> Iterator[Any]:
        """The messages; a container that unpacks to more than an object may have is refused."""
        while head := self.file.read(_OBJECT.size):
            mark, _, _, size, kind = _OBJECT.unpack(head)
            if mark != _MARK or size < _OBJECT.size:
                raise ValueError("an object does not begin as one")
            content = self.file.read(size - _OBJECT.size)
            self.file.read(size % _PADDING)
            if kind != _CONTAINER:
                continue
            (method,) = _METHOD.unpack_from(content)
            data = content[_METHOD.size :]
            if method == _DEFLATED:
                data = zlib.decompressobj().decompress(data, LARGEST_OBJECT + 1)
                if len(data) > LARGEST_OBJECT:
                    raise ValueError(f"an object unpacks to more than {LARGEST_OBJECT} bytes")
            if method in (_STORED, _DEFLATED):
                yield from self._parse_container(data)

    def _parse_container(self, data: bytes) -> Iterator[Any]:
        if len(self._tail) > LARGEST_OBJECT:
            raise ValueError(f"an object is larger than {LARGEST_OBJECT} bytes")
        yield from super()._parse_container(data)

    def _parse_data(self, data: bytes) -> Iterator[Any]:
        """The messages; an object of no size would be read for ever."""
        end = _sound_until(data)
        yield from super()._parse_data(data[:end])
        if end < len(data):
            raise ValueError("an object has no size")


class _Bounded:
    """A file that does not read more than an object may have."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self.close = file, file.close

    def read(self, size: int) -> bytes:
        if not 0 <= size <= LARGEST_OBJECT:
            raise ValueError(f"an object is larger than {LARGEST_OBJECT} bytes")
        return self._file.read(size)


def _sound_until(data: bytes) -> int:
    """Position of the first object that is shorter than its own header; else the end."""
    position = 0
    while True:
        position = data.find(_MARK, position, position + 2 * _PADDING)
        if position < 0 or position + _OBJECT.size > len(data):
            return len(data)
        size = _OBJECT.unpack_from(data, position)[3]
        if size < _OBJECT.size:
            return position
        position += size


def gvret_messages(lines: Iterable[str]) -> Iterator[can.Message]:
    """The frames of a CSV log of SavvyCAN, of its lines with the header first.

    Raises:
        ValueError: a row is none of such a log.
    """
    reader = csv.reader(lines)
    names = [name.strip("\ufeff ") for name in next(reader)]
    first = names.index("LEN") + 1
    for row in filter(any, reader):
        cells = dict(zip(names, row, strict=False))
        length = int(cells["LEN"])
        data = bytes(int(cell, 16) for cell in row[first : first + length])
        if len(data) < length:
            raise ValueError(f"{len(data)} of {length} bytes")
        yield can.Message(
            timestamp=int(cells["Time Stamp"]) * MICROSECOND,
            arbitration_id=int(cells["ID"], 16),
            is_extended_id=cells["Extended"].strip().lower() in ("true", "1"),
            is_rx=cells.get("Dir", "").strip().lower() != "tx",
            channel=cells.get("Bus"),
            dlc=length,
            data=data,
            is_fd=length > 8,
        )
