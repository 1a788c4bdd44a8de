"""Tables of text: CSV and its kin in any encoding, with any separator, plain or `.gz`."""

from __future__ import annotations

import codecs
from collections import Counter
from collections.abc import Iterator
import csv
import gzip
import io
from itertools import islice
from pathlib import Path
from typing import IO
import zlib

from evpinn_ros.errors import InputError
from evpinn_ros.text_lines import bounded_lines

MOST_COLUMNS = 10_000
MOST_BLANK = 100_000  # lines in a row
SEPARATORS = ",;\t|"
LOOKED_AT = 20  # lines that tell the separator
LOOKED_AT_BYTES = 4096

READ_ERRORS = (OSError, EOFError, zlib.error, ValueError, csv.Error)  # ValueError: no text

Row = tuple[int, list[str]]  # the number of its line in the file, its cells

codecs.register_error(
    "evpinn-cp1252",
    # Below an ASCII header a degree sign of Windows may come at any time.
    lambda error: (
        (error.object[error.start : error.end].decode("cp1252", "replace"), error.end)
        if isinstance(error, UnicodeDecodeError)
        else ("?", getattr(error, "end", 1))
    ),
)


class TextTable:
    """A text file with a row a line.

    Attributes:
        path: of it.
        torn: lines that are no row, for a quote in them is not closed; complete after `rows`.
    """

    def __init__(self, path: Path) -> None:
        """Find the separator.

        Raises:
            InputError: it cannot be read.
        """
        self.path = path
        self.torn = 0
        self._encoding = ""
        self.separator = self._separator()

    def rows(self) -> Iterator[Row]:
        """Every row that is not blank, comments and all.

        Raises:
            InputError: it cannot be read further.
        """
        self.torn = 0
        line = _Lines()
        try:
            with self._open() as file:
                reader = csv.reader(line.whole(bounded_lines(file)), delimiter=self.separator)
                for row in reader:
                    if len(row) > MOST_COLUMNS:
                        raise ValueError(f"a row of more than {MOST_COLUMNS} columns")
                    yield line.number, row
        except READ_ERRORS as error:
            where = f"{self.path}:{line.number + 1}" if line.number else str(self.path)
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"{where}: {reason}") from error
        finally:
            self.torn = line.torn

    def _separator(self) -> str:
        """What a line `sep=;` says, or the sign that most lines have in the same number."""
        try:
            with self._open() as file:
                lines = list(islice(bounded_lines(file), LOOKED_AT))
        except READ_ERRORS as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"{self.path}: {reason}") from error
        lines = [line for line in lines if line.strip()]
        if lines and lines[0].strip().strip('"').lower().startswith("sep="):
            said = lines[0].strip().strip('"')[4:]
            return said[:1] or "\t"
        counts = {
            sign: Counter(_outside_quotes(line, sign) for line in lines) for sign in SEPARATORS
        }

        def merit(sign: str) -> tuple[int, int]:
            most, times = max(counts[sign].items(), key=lambda each: (each[0] > 0) * each[1])
            return (times if most else 0, most)

        return max(SEPARATORS, key=merit) if lines else ","

    def _open(self) -> IO[str]:
        opener = gzip.open if self.path.suffix.lower() == ".gz" else Path.open
        if not self._encoding:
            with opener(self.path, "rb") as file:
                self._encoding = _encoding(file.read(LOOKED_AT_BYTES))
        return io.TextIOWrapper(
            opener(self.path, "rb"),
            encoding=self._encoding,
            errors="evpinn-cp1252" if self._encoding == "utf-8-sig" else "replace",
            newline="",
        )


class _Lines:
    """Lines that are whole rows, counted."""

    def __init__(self) -> None:
        self.number, self.torn = 0, 0

    def whole(self, lines: Iterator[str]) -> Iterator[str]:
        blank = 0
        for line in lines:
            self.number += 1
            if not line.strip("\r\n\t ,;"):
                blank += 1
                if blank > MOST_BLANK:
                    raise ValueError(f"more than {MOST_BLANK} blank lines")
                continue
            # No app writes a cell of two lines; an odd quote would swallow all that follows.
            if line.count('"') % 2:
                self.torn += 1
                blank += 1
                if blank > MOST_BLANK:
                    raise ValueError("a quote that is never closed")
                continue
            blank = 0
            yield line.replace("\0", "")


def _outside_quotes(line: str, sign: str) -> int:
    return sum(part.count(sign) for part in line.split('"')[::2])


def _encoding(start: bytes) -> str:
    """UTF-8 unless a mark or the zeros of UTF-16 say otherwise."""
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    even, odd = start[0::2].count(0), start[1::2].count(0)
    if len(start) > 3 and max(even, odd) > len(start) // 8:
        return "utf-16-be" if even > odd else "utf-16-le"
    return "utf-8-sig"
