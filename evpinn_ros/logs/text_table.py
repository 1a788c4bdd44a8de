"""Tables of text: CSV and variants in any encoding, with any separator, plain or `.gz`."""

from __future__ import annotations

import codecs
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
import csv
from io import SEEK_END, IncrementalNewlineDecoder
import os
from pathlib import Path
import re
from tempfile import TemporaryDirectory
from typing import IO, Any
import weakref
import zlib

import numpy as np

from evpinn_ros.common.errors import InputError, as_input_error, reason_of
from evpinn_ros.common.opener import LONGEST_LINE, MOST_COLUMNS, open_file, open_unpacked
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.sandbox import run_apart
from evpinn_ros.logs.batch import Batch, Row, batches_of

with optional_imports():
    import polars as pl

LONG_LINE, LONGEST_CELL = 2000, 200  # characters; in a long line, cells are cut at the second
MOST_BLANK = 100_000  # consecutive lines
SEPARATORS = ",;\t|"
LOOKED_AT = 20  # lines examined for the separator
LOOKED_AT_BYTES = 4096
MOSTLY_PAIRS = 0.8  # share of the non-ASCII bytes that are pairs in Chinese text
END = 1 << 16  # bytes that contain the last line
BLANK = "\r\n\t ,;"  # characters of a row without content

READ_ERRORS = (OSError, EOFError, zlib.error, ValueError, csv.Error)  # ValueError: no text

FIRST, CHUNK = 1 << 14, 1 << 20  # bytes read at once, at the header and below it
DIGITS = np.isin(np.arange(256), list(b"0123456789+-."))  # first bytes of a row of data

codecs.register_error(
    "evpinn-cp1252",
    # Below an ASCII header a Windows degree sign may occur at any time.
    lambda error: (
        (error.object[error.start : error.end].decode("cp1252", "replace"), error.end)
        if isinstance(error, UnicodeDecodeError)
        else ("?", getattr(error, "end", 1))
    ),
)


class TextTable:
    """A text file with one row per line.

    Attributes:
        path: of the file.
        torn: number of lines that are no row, with an open quote; complete after reading.
        broken: why the file ends early; empty or None if it does not.
    """

    broken: str | None = ""

    def __init__(self, path: Path, content: Path | None = None, separator: str = "") -> None:
        """Find the separator, unless given.

        The path is for messages; `content` is the file with the text, if different.

        Raises:
            InputError: the file cannot be read.
        """
        self.path, self._content = path, content or path
        self.torn = self._line = 0
        self._useless = 0  # consecutive lines without a row
        self._encoding = ""
        self._is_long = False  # True if the current line is long
        self.separator = separator or self._separator()

    def rows(self) -> Iterator[Row]:
        """Every row that is not blank, including comments.

        Raises:
            InputError: the rest of the file cannot be read.
        """
        with self._texts() as texts:
            for text in texts:
                yield from self._rows_of(text)

    def batches(self) -> Iterator[Batch]:
        """`rows` in batches: by column if lines begin with a number, unquoted and equally wide.

        Raises:
            InputError: the rest of the file cannot be read.
        """
        with self._texts() as texts:
            for text in texts:
                columns = self._columns(text)
                if columns is None:
                    yield from batches_of(self._rows_of(text))
                    continue
                first, self._line = self._line + 1, self._line + len(columns[0])
                widths = np.full(len(columns[0]), len(columns))
                yield Batch(range(first, self._line + 1), columns, widths)

    @contextmanager
    def _texts(self) -> Iterator[Iterator[str]]:
        """The text of the file; errors name their line."""
        self.torn = self._line = self._useless = 0
        try:
            with self._open() as file:
                yield self._chunks(file)
        except READ_ERRORS as error:
            where = f"{self.path}:{self._line + 1}" if self._line else str(self.path)
            raise InputError(f"{where}: {reason_of(error)}") from error
        if self.broken:
            raise InputError(f"{self.path}: {self.broken}")

    def _rows_of(self, text: str) -> Iterator[Row]:
        for row in csv.reader(self._whole_lines(text), delimiter=self.separator):
            if len(row) > MOST_COLUMNS:
                raise ValueError(f"a row of more than {MOST_COLUMNS} columns")
            if self._is_long:
                row = [cell[:LONGEST_CELL] for cell in row]
            yield self._line, row

    def _columns(self, text: str) -> list[pl.Series] | None:
        """Text of the columns; None if not all lines have the same number of unquoted cells."""
        if '"' in text:
            return None
        data = text.encode("utf-8", "replace")
        signs = np.frombuffer(data, np.uint8)
        ends = np.flatnonzero(signs == ord("\n"))
        if signs.size and (not ends.size or ends[-1] != signs.size - 1):
            ends = np.append(ends, signs.size)
        starts = np.append(0, ends[:-1] + 1)
        if not signs.size or not DIGITS[signs[starts]].all() or (ends - starts).max() > LONG_LINE:
            return None
        counts = np.add.reduceat(signs == ord(self.separator), starts, dtype=np.int64)
        if np.ptp(counts) or counts[0] >= MOST_COLUMNS:
            return None
        frame = pl.read_csv(
            data, has_header=False, infer_schema=False, separator=self.separator, quote_char=None
        )
        return list(frame.fill_null("").get_columns())

    def last_row(self) -> list[str]:
        """The cells of the last line; empty if the file does not show its end."""
        if self.path.suffix.lower() == ".gz":
            return []
        with suppress(*READ_ERRORS), self._open() as file:
            file.seek(max(0, file.seek(0, SEEK_END) - END))
            lines = file.read().decode(self._encoding, "replace").rstrip(BLANK).splitlines()
            return next(csv.reader(lines[-1:], delimiter=self.separator), [])
        return []

    def _separator(self) -> str:
        """Separator in a line `sep=;`, or the character most often equally frequent in lines."""
        with as_input_error(self.path, *READ_ERRORS), self._open() as file:
            lines = next(self._chunks(file), "").split("\n", LOOKED_AT)[:LOOKED_AT]
        lines = [line for line in lines if line.strip()]
        if lines and _says_separator(lines[0]):
            rest = lines[0].strip('\ufeff"\r\n ')[4:]
            return rest[:1] or "\t"
        counts = {
            sign: Counter(sum(part.count(sign) for part in line.split('"')[::2]) for line in lines)
            for sign in SEPARATORS
        }

        def merit(sign: str) -> tuple[int, int]:
            most, times = max(counts[sign].items(), key=lambda count: (count[0] > 0) * count[1])
            return (times if most else 0, most)

        return max(SEPARATORS, key=merit) if lines else ","

    def _open(self) -> IO[bytes]:
        return open_unpacked(self._content)

    def _whole_lines(self, text: str) -> Iterator[str]:
        """The lines that contain a row, counted.

        Raises:
            ValueError: an endless line, or too many lines without a row.
        """
        for line in text.removesuffix("\n").split("\n"):
            if len(line) > LONGEST_LINE:
                raise ValueError(f"a line is longer than {LONGEST_LINE} characters")
            self._line += 1
            quote = '"' in line
            if not line.strip(BLANK):
                self._useless += 1
            # No app writes a cell of two lines; an unpaired quote would include later lines.
            elif quote and line.count('"') % 2:
                self._useless, self.torn = self._useless + 1, self.torn + 1
            elif self._line > 1 or not _says_separator(line):
                self._useless = 0
                self._is_long = len(line) > LONG_LINE
                yield line
            if self._useless > MOST_BLANK:
                what = "a quote that is never closed" if quote else "nothing"
                raise ValueError(f"more than {MOST_BLANK} lines of {what}")

    def _chunks(self, file: Any) -> Iterator[str]:
        """The text of the file in whole lines; text before damage is kept."""
        self._encoding = self._encoding or _encoding(file.peek(LOOKED_AT_BYTES)[:LOOKED_AT_BYTES])
        errors = "evpinn-cp1252" if self._encoding == "utf-8-sig" else "replace"
        decode = codecs.getincrementaldecoder(self._encoding)(errors)
        decoder = IncrementalNewlineDecoder(decode, translate=True)
        left, size, error = "", FIRST, None
        while True:
            data = bytearray()
            try:
                while len(data) < size and (more := file.read1(size)):
                    data += more
            except READ_ERRORS as broken:
                error = broken
            is_last = error is not None or not data
            text = left + decoder.decode(bytes(data), final=is_last)
            whole, newline, left = ("", "", "") if is_last else text.rpartition("\n")
            # Zeros from a power loss count in the length of a line that remains.
            if text := (text if is_last else whole + newline).replace("\0", ""):
                yield text
            if error is not None:
                raise error
            if is_last:
                return
            if len(left) > LONGEST_LINE:
                if not left.strip("\0"):
                    raise OSError("endless zero bytes")  # the text before them is read
                raise ValueError(f"a line is longer than {LONGEST_LINE} characters")
            size = CHUNK


class ConvertedTable(TextTable):
    """A table that another library converted to text in a process of its own."""

    def __init__(self, path: Path, function: str) -> None:
        """Convert the file by `function`, named `MODULE:NAME`, which takes two paths.

        Raises:
            InputError: the file cannot be read.
        """
        with TemporaryDirectory() as folder:
            content = Path(folder, "table.csv")
            self.broken = run_apart(function, path, content)
            if not content.exists() or (self.broken and content.stat().st_size == 0):
                raise InputError(f"{path}: {self.broken or 'no table in it'}")
            with open_file(content) as file:  # an open file stays readable after its deletion
                kept = os.dup(file.fileno())
        weakref.finalize(self, os.close, kept)
        super().__init__(path, Path(f"/proc/self/fd/{kept}"), separator=",")


def _says_separator(line: str) -> bool:
    """True for a line such as `sep=;`, which tells Excel the separator."""
    return line.lstrip('\ufeff"').lower().startswith("sep=")


def _encoding(start: bytes) -> str:
    """UTF-8, unless a byte order mark, UTF-16 zeros or pairs of Chinese text indicate another."""
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    even, odd = start[0::2].count(0), start[1::2].count(0)
    if len(start) > 3 and max(even, odd) > len(start) // 8:
        return "utf-16-be" if even > odd else "utf-16-le"
    return "gb18030" if _is_chinese(start) else "utf-8-sig"


def _is_chinese(start: bytes) -> bool:
    """True if most non-ASCII bytes are common characters of GB 2312, and it is no UTF-8.

    Each is a pair of high bytes. In European code pages high bytes are single, except in Cyrillic,
    whose small letters lie above the first bytes of common characters.
    """
    with suppress(UnicodeDecodeError):
        codecs.getincrementaldecoder("utf-8")().decode(start)
        return False
    pairs = re.findall(rb"[\xa1-\xd7][\xa1-\xfe]", start)
    return 2 * len(pairs) > MOSTLY_PAIRS * len(re.findall(rb"[\x80-\xff]", start))
