"""Reading by the rosbags library: sqlite3 bags."""

from __future__ import annotations

from collections.abc import Container, Iterator
from contextlib import closing
from pathlib import Path
import re
import sqlite3
from urllib.parse import quote

from rosbags.rosbag2 import Reader

from evpinn_ros.bags.mcap_file import Channel, RawMessage
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import check_file

# What a damaged file makes rosbags raise is listed nowhere: errors of its own, of apsw, of zstd.
READ_ERRORS = (Exception,)
COMPUTING = re.compile(r"\b(VIRTUAL|GENERATED|AS)\b", re.I)  # in the definition of a table


class RosbagsFile:
    """An open `.db3` file; the counterpart of `McapFile`.

    Attributes:
        channels: by channel id.
        counts: messages by channel id.
        problem: what was lost, in one line. Complete once every message was read.
    """

    def __init__(self, path: Path) -> None:
        """Open it.

        Raises:
            InputError: it is not there, rosbags can not read it, or it is more than tables.
        """
        check_file(path)
        _refuse_programs(path)
        self.path = path
        self.problem: str | None = None
        self._reader = Reader(path)
        try:
            self._reader.open()
        except READ_ERRORS as error:
            raise InputError(f"{path}: {self._reason(error)}") from error
        self._connections = {connection.id: connection for connection in self._reader.connections}
        self.channels = {
            id_: Channel(connection.topic, connection.msgtype, connection.ext.serialization_format)
            for id_, connection in self._connections.items()
        }
        self.counts = {id_: each.msgcount for id_, each in self._connections.items()}

    def messages(self, wanted: Container[int]) -> Iterator[RawMessage]:
        """The messages of the wanted channel ids in log time order."""
        connections = [each for id_, each in self._connections.items() if id_ in wanted]
        if not connections:
            return
        read = 0
        try:
            for connection, log_time_ns, data in self._reader.messages(connections):
                yield log_time_ns, connection.id, bytes(data)
                read += 1
        except READ_ERRORS as error:
            self.problem = f"{self.path}: {self._reason(error)}; {read} messages were read"

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def _reason(self, error: Exception) -> str:
        """In one line, without the path that rosbags puts in some."""
        return " ".join(str(error).replace(str(self._reader.path), "").split())


def _refuse_programs(path: Path) -> None:
    """Refuse a database that computes: a view in place of a table can run for ever."""
    address = f"file:{quote(str(path))}?immutable=1"
    with (
        as_input_error(f"{path}: Cannot open database", *READ_ERRORS),
        closing(sqlite3.connect(address, uri=True)) as database,
    ):
        entries = database.execute("SELECT type, sql FROM sqlite_master").fetchall()
    for kind, sql in entries:
        if kind not in ("table", "index") or COMPUTING.search(str(sql)):
            raise InputError(f"{path}: no bag: its database has a {kind} that computes")
