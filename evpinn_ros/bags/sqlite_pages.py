"""Sizes of the rows of a SQLite file, read from its pages before SQLite loads the rows.

SQLite reads the whole schema before any query, and a whole text to know its length. Rows of a
damaged file may share overflow pages, or these may form a circle. Format: "Database File Format"
(sqlite.org).
"""

from __future__ import annotations

from collections.abc import Iterator
import os
import struct
from typing import BinaryIO

SCHEMA = 1  # root page of the table of tables
TOO_MUCH = "claims more bytes than its file has"
_HEADER = 100  # bytes of the file header, in the first page
_SIZE_AT = 16  # offset of the page size; the value 1 means 65536
_INTERIOR, _LEAF = 5, 13  # first byte of a table's pages
_COUNT_AT, _RIGHT_AT = 3, 8
_LONGEST_NUMBER = 9  # bytes of a varint


class SqlitePages:
    """The pages of an open file."""

    def __init__(self, file: BinaryIO) -> None:
        """Read the page size; an invalid file is left for SQLite to refuse."""
        self._file = file
        header = file.read(_HEADER).ljust(_HEADER, b"\0")
        (size,) = struct.unpack_from(">H", header, _SIZE_AT)
        self._size = 65536 if size == 1 else max(size, 512)
        self._count = os.fstat(file.fileno()).st_size // self._size

    def row_bytes(self, root: int) -> Iterator[int]:
        """Bytes of each row of a table; damaged pages have no rows, as for SQLite.

        ValueError if the table has more pages than the file.
        """
        waiting, left = [root], self._count
        while waiting:
            if not 0 < (number := waiting.pop()) <= self._count:
                continue
            left -= 1
            if left < 0:
                raise ValueError(TOO_MUCH)
            self._file.seek((number - 1) * self._size)
            page = self._file.read(self._size)
            begin = _HEADER if number == SCHEMA else 0
            try:
                kind, (count,) = page[begin], struct.unpack_from(">H", page, begin + _COUNT_AT)
                if kind not in (_INTERIOR, _LEAF):
                    continue
                places = begin + (12 if kind == _INTERIOR else 8)
                cells = struct.unpack_from(f">{count}H", page, places)
            except (IndexError, struct.error):
                continue
            if kind == _LEAF:
                yield from (_number(page, cell % self._size) for cell in cells)
                continue
            links = (begin + _RIGHT_AT, *(cell % self._size for cell in cells))
            waiting.extend(int.from_bytes(page[at : at + 4], "big") for at in links)


def _number(page: bytes, at: int) -> int:
    number = 0
    for byte in page[at : at + _LONGEST_NUMBER]:
        number = number << 7 | byte & 0x7F
        if byte < 0x80:
            break
    return number
