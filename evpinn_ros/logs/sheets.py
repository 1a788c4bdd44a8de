"""Converts workbooks to CSV by openpyxl in another process (`common.sandbox`)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import csv
from datetime import date, datetime, time
from itertools import islice
from pathlib import Path
from typing import Any

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import MOST_COLUMNS, open_file
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.writer import new_table, plain_cell
from evpinn_ros.logs.survey import OTHER_SHEETS, names_some

with suppress(ImportError):  # imported first, since limits of the process count from then on
    import openpyxl  # noqa: F401

MOST_EMPTY = 1000  # consecutive empty rows that end the sheet
EMPTY_ABOVE = 50  # rows above the header


def write_sheet(path: Path, out: Path) -> None:
    """Write the first visible sheet with a drive, and the sheets with the same header, as CSV."""
    with optional_imports():
        from openpyxl import load_workbook
    with open_file(path) as file, new_table(out) as table:
        book = load_workbook(file, read_only=True, data_only=True)
        writer = csv.writer(table)
        sheets = [sheet for sheet in book.worksheets if sheet.sheet_state == "visible"]
        sheets = sheets or book.worksheets
        heads = {sheet.title: list(islice(_rows(sheet), 2)) for sheet in sheets}
        # A sheet of a single line is a note.
        tables = [sheet for sheet in sheets if len(heads[sheet.title]) == 2] or sheets[-1:]
        drives = [sheet for sheet in tables if names_some(heads[sheet.title][0])]
        first = next(iter(drives), tables[0])
        same = [sheet for sheet in tables if heads[sheet.title][:1] == heads[first.title][:1]]
        if others := [sheet.title for sheet in tables if sheet not in same]:
            writer.writerow([f"{OTHER_SHEETS}{', '.join(map(plain_cell, others))}"])
        for sheet in same:
            writer.writerows(_rows(sheet))


def _rows(sheet: Any) -> Iterator[list[str]]:
    # The stated size of a sheet may be wrong, such as a million rows.
    sheet.reset_dimensions()
    empty, begun = 0, False
    for cells in sheet.iter_rows(values_only=True):
        if len(cells) > MOST_COLUMNS:
            raise InputError(f"a row of more than {MOST_COLUMNS} columns")
        row = [_text(cell) for cell in cells]
        if any(row):
            # Empty rows are written too, so that rows keep their numbers of the sheet.
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
    if value is None:
        return ""
    if isinstance(value, datetime | date | time):
        return value.isoformat(*([" "] if isinstance(value, datetime) else []))
    return plain_cell(str(value))
