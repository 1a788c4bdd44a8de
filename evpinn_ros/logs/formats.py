"""Formats of recorded drives, by file name, and the search for recordings."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
import os
from pathlib import Path
import zlib

from evpinn_ros.bags.names import BAG_SUFFIXES, is_bag
from evpinn_ros.can.log_names import GVRET_HEADER, LOG_SUFFIXES, MF4
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import open_unpacked
from evpinn_ros.common.writer import BAG_FILES

TEXT_SUFFIXES = (".csv", ".tsv", ".txt")
SHEET_SUFFIXES = (".xlsx", ".xlsm")
COLUMNAR_SUFFIXES = (".parquet", ".pq", ".feather", ".arrow")
JSON_SUFFIXES = (".jsonl", ".ndjson", ".json")
TABLE_SUFFIXES = (*TEXT_SUFFIXES, *SHEET_SUFFIXES, *COLUMNAR_SUFFIXES, *JSON_SUFFIXES, MF4)
CONVERTERS = {  # functions that convert a binary table to text, in a process of their own
    **dict.fromkeys(SHEET_SUFFIXES, "evpinn_ros.logs.sheets:write_sheet"),
    **dict.fromkeys(COLUMNAR_SUFFIXES, "evpinn_ros.logs.columnar:write_columns"),
    **dict.fromkeys(JSON_SUFFIXES, "evpinn_ros.logs.json_objects:write_objects"),
    MF4: "evpinn_ros.logs.measurement:write_signals",
}
# Suffixes in a folder of drives, where a .json may be a learned car or scores
_DRIVES = {*TABLE_SUFFIXES, *LOG_SUFFIXES} - {".json"}
_RECORDINGS = {*BAG_SUFFIXES, *_DRIVES} - {".txt"}  # sought in nested folders
FRAME_COLUMNS = (b"arbitration_id", GVRET_HEADER.encode())  # mark a CAN log's CSV


def suffix_of(path: Path) -> str:
    """Suffix of a path, in lower case and without .gz."""
    return Path(path.name.lower().removesuffix(".gz")).suffix


def unknown_kind(path: Path) -> InputError:
    """Error for a file that is no recording; it lists the supported kinds."""
    if suffix_of(path) in BAG_SUFFIXES:
        return InputError(f"{path}: bags are not read as .gz; unpack it first")
    logs, tables = ", ".join(LOG_SUFFIXES), ", ".join(TABLE_SUFFIXES)
    return InputError(f"{path}: neither a bag, a CAN log ({logs}) nor a table ({tables})")


def is_drive_table(path: Path) -> bool:
    """True if a path is a table that is no CAN log; InputError if unreadable."""
    suffix = suffix_of(path)
    if path.is_dir() or suffix not in TABLE_SUFFIXES:
        return False
    if suffix == MF4:
        return _holds_signals(path)
    if suffix != ".csv":
        return True
    with as_input_error(path, EOFError, zlib.error), open_unpacked(path) as file:
        header = file.readline(10_000)
    return not any(column in header for column in FRAME_COLUMNS)


def _holds_signals(path: Path) -> bool:
    """True if an .mf4 holds useful measured signals, not only frames of a bus."""
    from evpinn_ros.logs.text_table import ConvertedTable  # polars: a car's computer lacks it

    try:
        ConvertedTable(path, CONVERTERS[MF4])
    except InputError:
        return False
    return True


def files_of(path: Path) -> list[Path]:
    """The path itself, or, for a folder that is no bag, the drives in it, sorted by name."""
    if not path.is_dir() or any(file.suffix in BAG_FILES for file in path.iterdir()):
        return [path]
    return sorted(file for file in path.iterdir() if suffix_of(file) in _DRIVES) or [path]


def recordings(path: Path, seen: set[str] | None = None) -> Iterator[Path]:
    """The recordings at or below a path, unordered; real paths in `seen` are skipped and added.

    Links are followed last: a linked drive belongs to the car whose folder holds the file.
    OSError: a folder cannot be read.
    """
    seen = set() if seen is None else seen
    waiting = deque([path])
    while waiting:
        entry = waiting.popleft()
        real = os.path.realpath(entry)
        if real in seen:
            continue
        seen.add(real)
        if not entry.is_dir() or _is_bag_folder(entry):
            yield entry
            continue
        for inner in entry.iterdir():
            if is_bag(inner) or suffix_of(inner) in _RECORDINGS:
                (waiting.append if inner.is_symlink() else waiting.appendleft)(inner)


def _is_bag_folder(path: Path) -> bool:
    """True if a folder is one rosbag2 bag; a killed recorder leaves no metadata."""
    if (path / "metadata.yaml").is_file():
        return True
    files = (file for file in path.iterdir() if file.name.startswith(f"{path.name}_"))
    return any(is_bag(file) and file.is_file() for file in files)
