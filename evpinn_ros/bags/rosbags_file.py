"""Reads MCAP files with an index by the rosbags library."""

from __future__ import annotations

from collections.abc import Container, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

from evpinn_ros.bags.channel import Channel, RawMessage
from evpinn_ros.bags.limits import unpacked
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import check_file

# rosbags itself unpacks chunks without a limit.
DECOMPRESSORS.update({name: partial(unpacked, name) for name in ("zstd", "lz4")})

# rosbags documents no exceptions for damaged files: it raises its own and those of zstd.
READ_ERRORS = (Exception,)


class RosbagsFile:
    """An open MCAP file with an intact index."""

    def __init__(self, path: Path) -> None:
        """Open the file; InputError if rosbags cannot."""
        self.path = path
        self.problem: str | None = None  # losses; complete once all messages were read
        self._folder = TemporaryDirectory(prefix="evpinn-")
        try:
            self._open()
        except BaseException:
            self._folder.cleanup()
            raise

    def _open(self) -> None:
        path = self.path
        check_file(path)
        # rosbags parses the path as a URI, in which #, ? and % are reserved.
        link = Path(self._folder.name, "bag.mcap")
        link.symlink_to(path.resolve())
        self._reader = Reader(link)
        try:
            self._reader.open()
        except READ_ERRORS as error:
            raise InputError(f"{path}: {self._reason(error)}") from error
        self._connections = {connection.id: connection for connection in self._reader.connections}
        self.channels = {
            id_: Channel(
                connection.topic,
                connection.msgtype,
                connection.ext.serialization_format,
                connection.msgdef.data,
                connection.digest,
                tuple(connection.ext.offered_qos_profiles),
            )
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
            self.problem = f"{self.path}: {self._reason(error)}; {read} messages were read"

    def close(self) -> None:
        """Close the file."""
        self._reader.close()
        self._folder.cleanup()

    def _reason(self, error: Exception) -> str:
        return " ".join(str(error).replace(str(self._reader.path), "").split())
