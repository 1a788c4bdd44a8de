"""What the rosbags library reads: sqlite3 bags, and folders that rosbag2 compressed."""

from __future__ import annotations

from collections.abc import Container, Iterator
from pathlib import Path

from rosbags.rosbag2 import Reader

from evpinn_ros.bags.mcap_file import RawMessage
from evpinn_ros.bags.mcap_index import Channel
from evpinn_ros.errors import InputError

# What a damaged file makes rosbags raise is listed nowhere: errors of its own, of apsw, of zstd.
READ_ERRORS = (Exception,)


class RosbagsFile:
    """An open `.db3` file or bag folder; the counterpart of `McapFile`.

    Attributes:
        channels: by channel id.
        counts: messages by channel id.
        problem: what was lost, in one line. Complete once every message was read.
    """

    def __init__(self, path: Path) -> None:
        """Open it.

        Raises:
            InputError: it is not there, or rosbags can not read it.
        """
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
        return " ".join(str(error).replace(str(self.path), "").split())
