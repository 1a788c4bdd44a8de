"""Tables that are no text: the sheets of a spreadsheet, and Parquet."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from datetime import date, datetime, time
from itertools import islice
from pathlib import Path
from typing import IO, Any
import zipfile

import polars as pl

from evpinn_ros.common.errors import InputError, as_input_error, extra_needed
from evpinn_ros.drives.text_table import MOST_COLUMNS, Row

MOST_EMPTY = 1000  # rows in a row that hold nothing: the sheet is over
EMPTY_ABOVE = 50  # rows above the header
MOST_EMPTY_BYTES = 1 << 20  # of XML without a value
_PIECE = 1 << 16
MOST_UNPACKED = 4 << 30  # bytes that the parts of a workbook may claim
MOST_RATIO = 200
ROWS_AT_ONCE = 20_000


class SheetTable:
    """The first sheet of an .xlsx workbook that holds a table."""

    torn = 0

    def __init__(self, path: Path) -> None:
        """Check that the file is a workbook of a bearable size.

        Raises:
            InputError: it is none, or openpyxl is not installed.
        """
        self.path = path
        with as_input_error(path, zipfile.BadZipFile), zipfile.ZipFile(path) as archive:
            parts = archive.infolist()
        unpacked = sum(part.file_size for part in parts)
        if unpacked > MOST_UNPACKED or unpacked > MOST_RATIO * path.stat().st_size + (1 << 20):
            raise InputError(f"{path}: unpacks to over {MOST_RATIO} times its size")
        self._check_sheets()

    def _check_sheets(self) -> None:
        """Refuse sheets of nothing: openpyxl would read them to their end before the first row."""
        with zipfile.ZipFile(self.path) as archive:
            for name in archive.namelist():
                if not name.startswith("xl/worksheets/") or not name.endswith(".xml"):
                    continue
                with archive.open(name) as part:
                    self._check_part(part)

    def _check_part(self, part: IO[bytes]) -> None:
        empty = 0  # bytes since the last value
        measured = begun = False
        while piece := part.read(_PIECE):
            # Excel says first how large a sheet is, so openpyxl need not count its rows.
            measured = measured or b"<dimension" in piece
            if b"<v" in piece or b"<t" in piece:
                empty, begun = 0, True
                continue
            empty += len(piece)
            if empty > MOST_EMPTY_BYTES and not (begun and measured and b"</row>" in piece):
                raise InputError(f"{self.path}: more than {MOST_EMPTY_BYTES} bytes of empty cells")

    def rows(self) -> Iterator[Row]:
        """The rows that hold something, numbered as in the sheet.

        Raises:
            InputError: it cannot be read.
        """
        with extra_needed(f"{self.path}: .xlsx needs openpyxl", "tables"):
            import openpyxl
        try:
            book = openpyxl.load_workbook(self.path, read_only=True, data_only=True)
            try:
                for sheet in book.worksheets:
                    first = list(islice(self._of_sheet(sheet), 2))
                    if len(first) == 2 or sheet is book.worksheets[-1]:  # a line alone is a note
                        yield from self._of_sheet(sheet)
                        return
            finally:
                book.close()
        except InputError:
            raise
        except Exception as error:  # openpyxl over a damaged file: anything
            raise InputError(f"{self.path}: {error or type(error).__name__}") from error

    def last_row(self) -> list[str]:
        """No cells: a sheet does not show its end."""
        return []

    def _of_sheet(self, sheet: Any) -> Iterator[Row]:
        # The size that a sheet states is not trusted: it may be a million rows.
        sheet.reset_dimensions()
        empty, begun = 0, False
        for number, cells in enumerate(sheet.iter_rows(values_only=True), 1):
            if len(cells) > MOST_COLUMNS:
                raise InputError(
                    f"{self.path}:{number}: a row of more than {MOST_COLUMNS} columns"
                )
            row = [_text(cell) for cell in cells]
            if any(row):
                empty, begun = 0, True
                yield number, row
                continue
            empty += 1
            if empty > (MOST_EMPTY if begun else EMPTY_ABOVE):
                if not begun:
                    raise InputError(f"{self.path}: the first {empty} rows are empty")
                return


def _text(value: Any) -> str:
    """A cell as a text file would have it."""
    if value is None:
        return ""
    if isinstance(value, datetime | date | time):
        return value.isoformat(*([" "] if isinstance(value, datetime) else []))
    return str(value).strip()


class ParquetTable:
    """A Parquet file, read some rows at a time."""

    torn = 0

    def __init__(self, path: Path) -> None:
        """Read the names of the columns.

        Raises:
            InputError: it is no Parquet file.
        """
        self.path = path
        with as_input_error(path, pl.exceptions.PolarsError):
            schema = pl.read_parquet_schema(path)
        # Nested columns hold no signal; a Parquet of ours or of pandas has none.
        self._columns = [name for name, kind in schema.items() if not kind.is_nested()]
        if len(self._columns) > MOST_COLUMNS:
            raise InputError(f"{path}: more than {MOST_COLUMNS} columns")

    def rows(self) -> Iterator[Row]:
        """The names, then every row.

        Raises:
            InputError: it cannot be read.
        """
        yield 0, list(self._columns)
        start = 0
        while part := self._part(start, ROWS_AT_ONCE):
            yield from enumerate(part, start + 1)
            start += len(part)

    def last_row(self) -> list[str]:
        """The cells of the last row, none where it cannot be read."""
        with suppress(InputError):
            return next(iter(self._part(-1, 1)), [])
        return []

    def _part(self, start: int, count: int) -> list[list[str]]:
        columns = pl.col(self._columns).cast(pl.String, strict=False)
        with as_input_error(self.path, pl.exceptions.PolarsError):
            part = pl.scan_parquet(self.path).select(columns).slice(start, count).collect()
        return [["" if cell is None else cell for cell in row] for row in part.iter_rows()]
