"""What lies in the journal beside a sqlite3 bag: messages of a recording that was killed.

SQLite applies a journal when it opens a database to write. A bag is only read, so that is done to
a private copy of both.
"""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
import sqlite3

from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import open_file
from evpinn_ros.common.writer import copy_file

ENDINGS = ("-wal", "-journal")
SUPER_JOURNAL = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
"""End of a journal that names another file, which SQLite would look at, and perhaps delete."""
ATTEMPTS = 5  # to copy files that a recorder is writing


def journals(path: Path) -> list[Path]:
    """The files beside a database that hold a part of it."""
    beside = (path.with_name(path.name + ending) for ending in ENDINGS)
    return [journal for journal in beside if journal.is_file() and journal.stat().st_size]


def merged(path: Path, folder: Path) -> Path:
    """A copy of a database in an empty folder, with its journals applied.

    Raises:
        InputError: it cannot be copied, the journals cannot be applied or name other files, or
            the database is written too often for a copy of one moment.
    """
    copy = folder / "merged.db3"
    with as_input_error(path):
        _copy_all(path, copy)
    for journal in journals(copy):
        with open_file(journal) as file:
            file.seek(max(journal.stat().st_size - len(SUPER_JOURNAL), 0))
            if file.read() == SUPER_JOURNAL:
                raise InputError(f"{path}: its journal names other files")
    with (
        as_input_error(path, sqlite3.Error),
        closing(sqlite3.connect(copy, isolation_level=None)) as database,
    ):
        # Reads the schema, which makes SQLite look at the journals; no view or trigger runs.
        database.execute("PRAGMA journal_mode = DELETE").fetchall()
        database.execute("PRAGMA schema_version").fetchall()
    return copy


def _copy_all(path: Path, copy: Path) -> None:
    """Copy a database and its journals as they were at one moment."""
    for _ in range(ATTEMPTS):
        before = _states(path)
        for source in (path, *journals(path)):
            copy_file(source, copy.with_name(copy.name + source.name[len(path.name) :]))
        if _states(path) == before:
            return
        for stale in copy.parent.iterdir():
            stale.unlink()
    raise InputError(f"{path}: a recorder is writing it; try again when it has ended")


def _states(path: Path) -> list[tuple[str, int, int]]:
    sources = [(source, source.stat()) for source in (path, *journals(path))]
    return [(source.name, stat.st_size, stat.st_mtime_ns) for source, stat in sources]
