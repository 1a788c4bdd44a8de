"""File formats of recorded drives: which one a path is by its name, and the search for them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import zlib

from evpinn_ros.bags.can_frames import BAG_SUFFIXES
from evpinn_ros.can.log_readers import GVRET_HEADER
from evpinn_ros.can.logs import LOG_SUFFIXES
from evpinn_ros.common.errors import as_input_error
from evpinn_ros.common.plain_file import open_file
from evpinn_ros.common.unpacking import open_gzipped
from evpinn_ros.drives.measurement import holds_signals

TEXT_SUFFIXES = (".csv", ".tsv", ".txt")
SHEET_SUFFIXES = (".xlsx", ".xlsm")
PARQUET_SUFFIXES = (".parquet", ".pq")
MEASUREMENT_SUFFIX = ".mf4"
TABLE_SUFFIXES = (*TEXT_SUFFIXES, *SHEET_SUFFIXES, *PARQUET_SUFFIXES, MEASUREMENT_SUFFIX)
FRAME_COLUMNS = (b"arbitration_id", GVRET_HEADER.encode())  # tell a CAN log's CSV from a drive's


def suffix_of(path: Path) -> str:
    """In lower case and without .gz."""
    return Path(path.name.lower().removesuffix(".gz")).suffix


def is_drive_table(path: Path) -> bool:
    """True if a path is that of a table which is no log of a CAN bus.

    Raises:
        InputError: it cannot be read.
    """
    suffix = suffix_of(path)
    if path.is_dir() or suffix not in TABLE_SUFFIXES:
        return False
    if suffix == MEASUREMENT_SUFFIX:
        return holds_signals(path)
    if suffix != ".csv":
        return True
    with (
        as_input_error(path, EOFError, zlib.error),
        open_gzipped(path) if path.suffix == ".gz" else open_file(path) as file,
    ):
        header = file.readline(10_000)
    return not any(column in header for column in FRAME_COLUMNS)


def recordings(path: Path) -> Iterator[Path]:
    """The recordings at or below a path, in no order; a file is taken for one, whatever it is.

    Raises:
        OSError: a folder cannot be read.
    """
    if path.is_file() or _is_bag_folder(path):
        yield path
        return
    for inner in path.iterdir():
        if inner.is_dir():
            yield from recordings(inner)
        # Most texts are a read-me.
        elif suffix_of(inner) in {*BAG_SUFFIXES, *LOG_SUFFIXES, *TABLE_SUFFIXES} - {".txt"}:
            yield inner


def _is_bag_folder(path: Path) -> bool:
    """True if a folder is one bag, as rosbag2 writes it; a killed recorder left no metadata.

    Other folders with bag files hold as many bags.
    """
    if (path / "metadata.yaml").is_file():
        return True
    names = (each.name for each in path.iterdir() if each.suffix in BAG_SUFFIXES)
    return any(name.startswith(f"{path.name}_") for name in names)
