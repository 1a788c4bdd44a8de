"""One `.db3` file of rosbag2: two tables, read by simple queries of bounded time.

Views, generated columns and defaults are refused, because SQLite could evaluate them endlessly.
The journal of a killed recording is applied to a private copy of database and journal.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import closing
from itertools import accumulate
import math
import os
from pathlib import Path
import re
import sqlite3
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

from evpinn_ros.bags.channel import Channel, RawMessage, parsed_qos
from evpinn_ros.bags.limits import LONGEST_CHUNK, MOST_DEFINITIONS
from evpinn_ros.bags.sqlite_pages import SCHEMA, TOO_MUCH, SqlitePages
from evpinn_ros.common.errors import InputError, as_input_error, one_line
from evpinn_ros.common.opener import check_file, open_file
from evpinn_ros.common.writer import copy_file

ROLLBACK = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
"""Magic bytes of a journal. A journal that also ends with them names another file, which SQLite
would open and perhaps delete."""
BEGINS = {"-wal": (b"\x37\x7f\x06\x82", b"\x37\x7f\x06\x83"), "-journal": (ROLLBACK,)}
"""Suffixes of journals and the magic bytes that they begin with; SQLite ignores others."""
SHORTEST = 32  # bytes of a journal's header, before its frames or pages
ATTEMPTS = 5  # to copy files that a recorder is writing

FREE_STEPS, STEPS_A_BYTE = 1_000_000, 4
"""Steps of SQLite's virtual machine; a bag of small messages needs half a step per byte."""
PERIOD = 1000  # steps
DAMAGE = (sqlite3.Error, UnicodeError)  # UnicodeError if SQLite's message quotes the file
MOST_ENTRIES, MOST_SCHEMA = 100, 100_000  # tables and indices, bytes; rosbag2 makes six in 1 kB
MOST_TOPICS = 10_000
# Messages are blobs: text counts as too large, since SQLite would load it to know its length.
MESSAGE_BYTES = """SELECT total(
    CASE typeof(data) WHEN 'blob' THEN length(data) WHEN 'text' THEN 1e18 ELSE 0 END
) FROM messages NOT INDEXED"""
# Keywords that are refused in the definition of a table.
COMPUTING = re.compile(r"\b(VIRTUAL|GENERATED|AS|WITHOUT|DEFAULT)\b", re.I)
TOPIC_COLUMNS = ("id", "name", "type", "serialization_format")
LATER_COLUMNS = ("offered_qos_profiles", "type_description_hash")  # missing in older bags


def journals(path: Path) -> list[Path]:
    """Journals of a database that SQLite would apply, by their headers."""
    return [journal for journal, begins in _beside(path) if begins]


def _beside(path: Path) -> Iterator[tuple[Path, bool]]:
    """Journals of a database that are not blank, and whether SQLite would apply each."""
    for ending, begins in BEGINS.items():
        journal = path.with_name(path.name + ending)
        if journal.is_file():
            with as_input_error(journal), open_file(journal) as file:
                header = file.read(SHORTEST)
            if header.strip(b"\0"):  # SQLite zeroes the header of a finished journal
                yield journal, len(header) == SHORTEST and header.startswith(begins)


def merged(path: Path, folder: Path) -> Path:
    """Copy a database with its journals applied into an empty folder; or InputError."""
    copy, whole = folder / "copy.db3", folder / "merged.db3"
    with as_input_error(path):
        _copy_all(path, copy)
    for journal in journals(copy):
        with open_file(journal) as file:
            file.seek(max(journal.stat().st_size - len(ROLLBACK), 0))
            if file.read() == ROLLBACK:
                raise InputError(f"{path}: its journal names other files")
    with (
        as_input_error(path, *DAMAGE),
        closing(sqlite3.connect(copy)) as database,
        closing(sqlite3.connect(whole)) as target,
    ):
        database.backup(target)  # copies pages without evaluating the schema, not checked yet
    return whole


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


class SqliteFile:
    """An open `.db3` file."""

    def __init__(self, path: Path) -> None:
        """Open the file; InputError if it is no bag, or computes values, as views do."""
        self.path = path
        self.problem: str | None = None  # losses; complete once all messages were read
        self.notes: list[str] = []  # files beside it that are not read, and lose no message
        self._folder = TemporaryDirectory(prefix="evpinn-")
        self._database: sqlite3.Connection | None = None
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        check_file(self.path)
        source = self._with_journals()
        address = f"file:{quote(bytes(source.resolve()))}?immutable=1"
        with (
            as_input_error(f"{self.path}: Cannot open database", *DAMAGE),
            open_file(source) as file,
        ):
            self._size = os.fstat(file.fileno()).st_size
            pages = SqlitePages(file)
            self._refuse(_schema_fault, pages)
            self._database = sqlite3.connect(address, uri=True, check_same_thread=False)
            self._database.text_factory = lambda text: text.decode(errors="replace")
            self._begin_steps()
            self._refuse(_fault, self._database, pages, self._size)
            self.channels = self._channels(self._database)  # by channel id
            self._begin_steps()
            self.counts = {
                id_: count
                for id_, count in self._database.execute(
                    "SELECT topic_id, count(*) FROM messages GROUP BY topic_id"
                )
                if id_ in self.channels
            }

    def _refuse(self, fault: Callable[..., str | None], *arguments: Any) -> None:
        try:
            reason = fault(*arguments)
        except ValueError as error:  # raised by `SqlitePages`
            reason = str(error)
        if reason is not None:
            raise InputError(f"{self.path}: no bag: its database {reason}")

    def _begin_steps(self) -> None:
        """Limit the following queries to the steps that an intact file of this size needs."""
        assert self._database is not None
        periods = iter(range((FREE_STEPS + STEPS_A_BYTE * self._size) // PERIOD))
        self._database.set_progress_handler(lambda: next(periods, None) is None, PERIOD)

    def _channels(self, database: sqlite3.Connection) -> dict[int, Channel]:
        definitions: dict[object, str] = {}
        if "encoded_message_definition" in _columns(database, "message_definitions"):
            rows = database.execute(
                "SELECT topic_type, encoded_message_definition FROM message_definitions "
                "NOT INDEXED"
            )
            definitions = {name: text for name, text in rows if isinstance(text, str)}
        there = _columns(database, "topics")
        texts = [name if name in there else "''" for name in LATER_COLUMNS]
        columns = ", ".join((*TOPIC_COLUMNS, *texts))
        rows = database.execute(
            f"SELECT {columns} FROM topics NOT INDEXED LIMIT {MOST_TOPICS + 1}"
        )
        channels: dict[int, Channel] = {}
        for number, (id_, *names, qos, type_hash) in enumerate(rows):
            if id_ in channels or number == MOST_TOPICS:
                fault = "topics with one id" if id_ in channels else f"over {MOST_TOPICS} topics"
                raise InputError(f"{self.path}: no bag: its database has {fault}")
            # In a damaged row a name may be NULL or a number.
            if isinstance(id_, int) and all(isinstance(name, str) for name in names):
                name, kind, encoding = names
                definition, profiles = definitions.get(kind, ""), parsed_qos(qos)
                channels[id_] = Channel(name, kind, encoding, definition, str(type_hash), profiles)
            else:
                self._note("a topic without a name is not read")
        return channels

    def messages(self, wanted: Container[int]) -> Iterator[RawMessage]:
        """The messages of the wanted channel ids in log time order."""
        assert self._database is not None
        ids = [id_ for id_ in self.channels if id_ in wanted]
        if not ids:
            return
        query = (
            "SELECT timestamp, topic_id, CASE WHEN typeof(data) = 'blob' AND length(data) <= "
            f"{LONGEST_CHUNK} THEN data END FROM messages "
            f"WHERE topic_id IN ({', '.join(map(str, ids))}) ORDER BY timestamp"
        )
        read = damaged = held = 0
        self._begin_steps()
        try:
            for log_time_ns, id_, data in self._database.execute(query):
                if not isinstance(log_time_ns, int) or log_time_ns < 0 or data is None:
                    damaged += 1
                    continue
                held += len(data)  # a damaged index may list other rows, or one row many times
                if held > self._size:
                    raise sqlite3.DatabaseError("an index lists more bytes than the file has")
                yield log_time_ns, id_, data
                read += 1
        except DAMAGE as error:
            self._note(f"{one_line(error)}; {read} messages were read")
        if damaged:
            self._note(f"{damaged} messages without a time or data are not read")

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        if self._database is not None:
            self._database.close()
        self._folder.cleanup()

    def _with_journals(self) -> Path:
        database = self.path.resolve()  # SQLite writes its journals next to the real file
        for journal, begins in _beside(database):
            if not begins:
                self.notes.append(
                    f"{self.path}: {journal.name} beside it has no header; "
                    "SQLite does not read it either"
                )
        beside = journals(database)
        if not beside:
            return self.path
        folder = Path(self._folder.name, "merged")
        folder.mkdir()
        try:
            copy = merged(database, folder)
        except InputError as error:
            names = ", ".join(journal.name for journal in beside)
            reason = str(error).removeprefix(f"{database}: ")
            self._note(f"{names} beside it could not be read ({reason}): messages are missing")
            return self.path
        return copy

    def _note(self, text: str) -> None:
        note = f"{self.path}: {text}"
        self.problem = note if self.problem is None else f"{self.problem} | {note}"


def _columns(database: sqlite3.Connection, table: str) -> set[str]:
    return {row[1] for row in database.execute(f"PRAGMA table_info({table})")}


def _schema_fault(pages: SqlitePages) -> str | None:
    """Why a schema cannot be that of a bag, or None; checked because SQLite loads all of it."""
    for number, held in enumerate(accumulate(pages.row_bytes(SCHEMA)), start=1):
        if number > MOST_ENTRIES:
            return f"has more than {MOST_ENTRIES} tables and indices"
        if held > MOST_SCHEMA:
            return f"describes its tables in more than {MOST_SCHEMA} bytes"
    return None


def _fault(database: sqlite3.Connection, pages: SqlitePages, size: int) -> str | None:
    """Why a database is no bag, in words after "its database"; None for a bag.

    A view instead of a table, or pages in a circle, could keep SQLite busy forever.
    """
    entries = database.execute("SELECT type, name, sql, rootpage FROM sqlite_master").fetchall()
    for kind, _, sql, _ in entries:  # check all entries before reading any table
        if kind not in ("table", "index") or COMPUTING.search(str(sql)):
            return f"has a {kind} that computes values or lacks row ids, as no recorder writes"
    roots = {
        name: root for kind, name, _, root in entries if kind == "table" and type(root) is int
    }
    for table in ("topics", "messages"):
        if table not in roots:
            return f"has no table '{table}'"
    for table in ("topics", "message_definitions"):
        rows = pages.row_bytes(roots.get(table, 0))
        if any(held > MOST_DEFINITIONS for held in accumulate(rows)):
            return f"has more than {MOST_DEFINITIONS} bytes of {table}"
    indices = [str(name) for kind, name, _, _ in entries if kind == "index"]
    return TOO_MUCH if _holds_more(database, indices, size) else None


def _holds_more(database: sqlite3.Connection, indices: Iterable[str], size: int) -> bool:
    """True if the messages exceed `size` bytes, or messages or an index have no end."""
    try:
        (held,) = database.execute(MESSAGE_BYTES).fetchone()
    except DAMAGE as error:
        held = math.inf if str(error) == "interrupted" else 0
    for name in indices:
        quoted = '"' + name.replace('"', '""') + '"'
        try:
            database.execute(f"SELECT count(*) FROM messages INDEXED BY {quoted}").fetchone()
        except DAMAGE as error:
            held = math.inf if str(error) == "interrupted" else held
    return bool(held > size)
