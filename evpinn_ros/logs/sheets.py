"""Workbooks of spreadsheets as text, by openpyxl, which runs apart (`common.apart`)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import csv
from datetime import date, datetime, time
from itertools import islice
from pathlib import Path
from typing import Any

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import open_file
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.writer import new_table
from evpinn_ros.logs.text_table import MOST_COLUMNS, plain_cell

with suppress(ImportError):  # at once, for the process is limited from what it took until then
    import openpyxl  # noqa: F401

MOST_EMPTY = 1000  # rows in a row that hold nothing: the sheet is over
EMPTY_ABOVE = 50  # rows above the header


def write_sheet(path: Path, out: Path) -> None:
    """Write the first sheet of an .xlsx that holds a table, a row a line."""
    with optional_imports():
        from openpyxl import load_workbook
    with open_file(path) as file, new_table(out) as table:
        book = load_workbook(file, read_only=True, data_only=True)
        writer = csv.writer(table)
        for sheet in book.worksheets:
            first = list(islice(_rows(sheet), 2))
            if len(first) == 2 or sheet is book.worksheets[-1]:  # a line alone is a note
                writer.writerows(_rows(sheet))
                return


def _rows(sheet: Any) -> Iterator[list[str]]:
    # The size that a sheet states is not trusted: it may be a million rows.
    sheet.reset_dimensions()
    empty, begun = 0, False
    for cells in sheet.iter_rows(values_only=True):
        if len(cells) > MOST_COLUMNS:
            raise InputError(f"a row of more than {MOST_COLUMNS} columns")
        row = [_text(cell) for cell in cells]
        if any(row):
            # Rows keep the number that they have in the sheet.
            yield from ([] for _ in range(empty))
            empty, begun = 0, True
            yield row
            continue
        empty += 1
        if empty > (MOST_EMPTY if begun else EMPTY_ABOVE):
            if not begun:
                raise InputError(f"the first {empty} rows are empty")
            return


def _text(value: Any) -> str:
    """A cell as a text file would have it."""
    if value is None:
        return ""
    if isinstance(value, datetime | date | time):
        return value.isoformat(*([" "] if isinstance(value, datetime) else []))
    return plain_cell(str(value))
