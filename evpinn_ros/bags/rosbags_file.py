"""Reading by the rosbags library: sqlite3 bags, and MCAP files that have their index.

SQLite applies a killed recording's journal when it opens a private copy of both to write.
"""

from __future__ import annotations

from collections.abc import Container, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import accumulate, islice
from pathlib import Path
import re
import sqlite3
from tempfile import TemporaryDirectory
from typing import TypeAlias
from urllib.parse import quote

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

from evpinn_ros.bags.limits import unpacked
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import check_file, open_file
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
    """A copy of a database in an empty folder, its journals applied; or InputError."""
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


# rosbags unpacks whatever a chunk holds, without a limit.
DECOMPRESSORS.update({name: partial(unpacked, name) for name in ("zstd", "lz4")})

# What a damaged file makes rosbags raise is listed nowhere: errors of its own, of apsw, of zstd.
READ_ERRORS = (Exception,)
FREE_STEPS, STEPS_A_BYTE = 1_000_000, 4
"""Steps of SQLite's machine; to look through a bag of small messages takes half a step a byte."""
PERIOD = 1000  # steps
# Text, of which no message is, would be read to know its length; of what was cut nothing is left.
MESSAGE_BYTES = """SELECT total(
    CASE typeof(data) WHEN 'blob' THEN length(data) WHEN 'text' THEN 1e18 ELSE 0 END
) FROM messages NOT INDEXED"""
COMPUTING = re.compile(r"\b(VIRTUAL|GENERATED|AS)\b", re.I)  # in the definition of a table


RawMessage: TypeAlias = tuple[int, int, bytes]  # log time, ns; channel id; data


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic of a file, the type of its messages, and how they are encoded."""

    topic: str
    type_name: str
    encoding: str


class RosbagsFile:
    """An open `.db3` file, or an MCAP file whose index is sound."""

    def __init__(self, path: Path) -> None:
        """Open it; InputError if rosbags cannot, or it is more than tables."""
        self.path = path
        self.problem: str | None = None  # what was lost, complete once all was read
        self._folder = TemporaryDirectory(prefix="evpinn-")
        try:
            self._open()
        except BaseException:
            self._folder.cleanup()
            raise

    def _open(self) -> None:
        path = source = self.path
        size = check_file(path)
        if path.suffix == ".db3":
            source, size = self._with_journals(size)
            _check_database(path, source, size)
        # rosbags takes the path as an address, in which #, ? and % are no letters.
        link = Path(self._folder.name, "bag.db3" if path.suffix == ".db3" else "bag.mcap")
        link.symlink_to(source.resolve())
        self._reader = Reader(link)
        try:
            self._reader.open()
        except READ_ERRORS as error:
            raise InputError(f"{path}: {self._reason(error)}") from error
        # A damaged row has nothing or a number where a name stands.
        named = [connection for connection in self._reader.connections if _is_named(connection)]
        if len(named) < len(self._reader.connections):
            self._note("a topic without a name is not read")
        self._connections = {connection.id: connection for connection in named}
        self.channels = {
            id_: Channel(connection.topic, connection.msgtype, connection.ext.serialization_format)
            for id_, connection in self._connections.items()
        }  # by channel id
        self.counts = {id_: connection.msgcount for id_, connection in self._connections.items()}

    def messages(self, wanted: Container[int]) -> Iterator[RawMessage]:
        """The messages of the wanted channel ids in log time order."""
        connections = [
            connection for id_, connection in self._connections.items() if id_ in wanted
        ]
        if not connections:
            return
        read = 0
        try:
            for connection, log_time_ns, data in self._reader.messages(connections):
                yield log_time_ns, connection.id, bytes(data)
                read += 1
        except READ_ERRORS as error:
            self._note(f"{self._reason(error)}; {read} messages were read")

    def close(self) -> None:
        """Close the file."""
        self._reader.close()
        self._folder.cleanup()

    def _with_journals(self, size: int) -> tuple[Path, int]:
        database = self.path.resolve()  # beside which SQLite writes its journals
        beside = journals(database)
        if not beside:
            return self.path, size
        folder = Path(self._folder.name, "merged")
        folder.mkdir()
        try:
            copy = merged(database, folder)
        except InputError as error:
            names = ", ".join(journal.name for journal in beside)
            reason = str(error).removeprefix(f"{database}: ")
            self._note(f"{names} beside it could not be read ({reason}): messages are missing")
            return self.path, size
        return copy, copy.stat().st_size

    def _note(self, text: str) -> None:
        note = f"{self.path}: {text}"
        self.problem = note if self.problem is None else f"{self.problem} | {note}"

    def _reason(self, error: Exception) -> str:
        return " ".join(str(error).replace(str(self._reader.path), "").split())


def _is_named(connection: Connection) -> bool:
    texts = (connection.topic, connection.msgtype, connection.ext.serialization_format)
    return all(isinstance(text, str) for text in texts)


def _check_database(path: Path, source: Path, size: int) -> None:
    """InputError for a database that computes or holds more than its file.

    A view in place of a table, or pages that lead to one another, could run for ever: SQLite
    follows both.
    """
    address = f"file:{quote(str(source))}?immutable=1"
    periods = iter(range((FREE_STEPS + STEPS_A_BYTE * size) // PERIOD))
    with (
        as_input_error(f"{path}: Cannot open database", *READ_ERRORS),
        closing(sqlite3.connect(address, uri=True)) as database,
    ):
        database.set_progress_handler(lambda: next(periods, None) is None, PERIOD)
        entries = list(islice(database.execute("SELECT type, name, sql FROM sqlite_master"), 100))
        fault = next(filter(None, (_fault(database, entry, size) for entry in entries)), None)
    if fault is not None:
        raise InputError(f"{path}: no bag: its database {fault}")


def _fault(database: sqlite3.Connection, entry: tuple[str, str, str], size: int) -> str | None:
    kind, name, sql = entry
    if kind not in ("table", "index") or COMPUTING.search(str(sql)):
        return f"has a {kind} that computes"
    return "holds more than its file" if _holds_more(database, kind, name, size) else None


def _holds_more(database: sqlite3.Connection, kind: str, name: str, size: int) -> bool:
    """True if a table holds more than so many bytes, or an index or a table does not end."""
    quoted = '"' + name.replace('"', '""') + '"'
    try:
        if kind == "index":
            database.execute(f"SELECT count(*) FROM messages INDEXED BY {quoted}").fetchone()
            return False
        if name == "messages":  # of a blob its length is known without reading it
            (held,) = database.execute(MESSAGE_BYTES).fetchone()
            return bool(held > size)
        rows = database.execute(f"SELECT * FROM {quoted} NOT INDEXED")
        sizes = (sum(len(cell) for cell in row if isinstance(cell, str | bytes)) for row in rows)
        return any(held > size for held in accumulate(sizes))
    except sqlite3.DatabaseError as error:
        return str(error) == "interrupted"
