"""Sound drives of every format that the campaign of attacks damages, made by code.

`python -m benchmarks.attack_seeds KIND FOLDER` writes them: a process in which polars has worked
cannot be forked, for its threads would be missing.
"""

from __future__ import annotations

from collections.abc import Callable
import gzip
from io import BytesIO
from pathlib import Path
import sys
from tempfile import TemporaryDirectory

import can
import numpy as np
import polars as pl

from benchmarks.fuzz_seeds import csv_drive, database, mcap_files

ROWS = 300


def _table() -> pl.DataFrame:
    """A drive of 30 s as a table of numbers."""
    time = np.arange(ROWS) / 10
    speed = 8 - 8 * np.cos(time / 8)
    current = 12 + 5 * speed * np.sin(time / 8)
    columns = {"t_s": time, "speed_mps": speed, "voltage_v": 380 - current / 10}
    return pl.DataFrame(columns | {"current_a": current, "ambient_c": np.full(ROWS, 6.5)})


def workbooks() -> list[bytes]:
    """A workbook of openpyxl."""
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    sheet = book.create_sheet("drive")
    table = _table()
    sheet.append(table.columns)
    for row in table.rows():
        sheet.append(row)
    book.save(file := BytesIO())
    return [file.getvalue()]


def parquet_files() -> list[bytes]:
    """Parquet of polars, in three compressions."""
    files = []
    for compression in ("zstd", "snappy", "uncompressed"):
        _table().write_parquet(file := BytesIO(), compression=compression)
        files.append(file.getvalue())
    return files


def can_drive(suffix: str) -> list[bytes]:
    """A CAN log of frames of a Tesla Model 3, its battery's among them, by python-can."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"drive{suffix}"
        with can.Logger(str(path)) as logger:
            for index in range(200):
                data = bytes((0x40, 0x8E, index % 100, 0, 0, 0, 0, 0))
                can_id = 0x132 if index % 2 else 0x257
                stamp = 1.5e9 + index / 100
                frame = can.Message(stamp, can_id, is_extended_id=False, data=data)
                logger.on_message_received(frame)
        return [path.read_bytes()]


def _text() -> list[bytes]:
    return [*csv_drive(), _table().write_csv().encode()]


SEEDS: dict[str, tuple[str, Callable[[], list[bytes]]]] = {
    "xlsx": (".xlsx", workbooks),
    "parquet": (".parquet", parquet_files),
    "blf": (".blf", lambda: can_drive(".blf")),
    "asc": (".asc", lambda: can_drive(".asc")),
    "trc": (".trc", lambda: can_drive(".trc")),
    "csv": (".csv", _text),
    "gz": (".csv.gz", lambda: [gzip.compress(each, mtime=0) for each in _text()]),
    "log_gz": (".log.gz", lambda: [gzip.compress(each, mtime=0) for each in can_drive(".log")]),
    "mcap": (".mcap", mcap_files),
    "db3": (".db3", database),
}
"""Suffix and sound files of each format, by its name."""


if __name__ == "__main__":
    for number, content in enumerate(SEEDS[sys.argv[1]][1]()):
        Path(sys.argv[2], str(number)).write_bytes(content)
