"""Converts a rosbag2 bag from MCAP to sqlite3 or back, with every topic unchanged."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from itertools import takewhile
from operator import itemgetter
from pathlib import Path
from shutil import rmtree
import sqlite3
from typing import Any
from urllib.parse import quote

from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.errors import WriterError
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import TypesysError

from evpinn_ros.bags.channel import Channel
from evpinn_ros.bags.limits import LONGEST_MESSAGE
from evpinn_ros.bags.metadata import VERSION
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import typestore
from evpinn_ros.common.errors import InputError, one_line
from evpinn_ros.common.units import MEBIBYTE
from evpinn_ros.core.signals.progress import reported


class Storage(str, Enum):
    """Storage format of a rosbag2 bag."""

    MCAP = "mcap"
    SQLITE3 = "sqlite3"


def _sqlite3_writer(path: Path, compression: CompressionMode) -> Any:
    """The library's writer; it parses a path as a URI, in which #, ? and % are reserved."""
    writer = Sqlite3Writer(Path(quote(bytes(path.resolve()))), compression)
    writer.path = path / f"{path.name}.db3"
    return writer


Writer.STORAGE_PLUGINS[StoragePlugin.SQLITE3] = _sqlite3_writer


def change_storage(
    source: Path,
    out: Path,
    storage: Storage,
    progress: Callable[[float], None] | None = None,
    stopped: Callable[[], bool] = lambda: False,
    note: Callable[[str], object] = lambda _: None,
) -> int:
    """Write the messages of a bag, byte for byte, into a new bag; returns their number.

    `progress` gets the seconds of log time copied; copying ends once `stopped` returns True;
    `note` gets the bag's notes. InputError: `out` exists or is not writable, or messages are
    missing; then `out` has the others.
    """
    if out.exists():
        raise InputError(f"{out}: exists already; give the name of a new folder")
    with BagReader(source) as reader:
        for line in reader.notes:
            note(line)
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            count, left_out = _copy(reader, out, storage, progress, stopped)
        except InputError:
            rmtree(out, ignore_errors=True)
            raise
        except (WriterError, TypesysError, sqlite3.Error, OverflowError, OSError) as error:
            rmtree(out, ignore_errors=True)
            raise InputError(f"{source} to {out}: {one_line(error)}") from error
        problems = [reader.problem] if reader.problem is not None else []
        if left_out:
            problems.append(
                f"{source}: {left_out} messages of over {LONGEST_MESSAGE // MEBIBYTE} MiB left out"
            )
        if problems:
            raise InputError(f"{' | '.join(problems)}; what could be read is in {out}")
        return count


def _copy(
    reader: BagReader,
    out: Path,
    storage: Storage,
    progress: Callable[[float], None] | None,
    stopped: Callable[[], bool],
) -> tuple[int, int]:
    """Numbers of messages copied and left out as too long: a writer holds each five times."""
    count = left_out = 0
    with Writer(out, version=VERSION, storage_plugin=StoragePlugin[storage.name]) as writer:
        channels = sorted(reader.channels(), key=lambda channel: channel.topic)
        new = {channel: _connect(writer, channel) for channel in channels}
        messages = takewhile(lambda _: not stopped(), reader.stored())
        for log_time_ns, channel, data in reported(messages, progress, itemgetter(0)):
            if len(data) > LONGEST_MESSAGE:
                left_out += 1
                continue
            writer.write(new[channel], log_time_ns, data)
            count += 1
    return count, left_out


def _connect(writer: Writer, channel: Channel) -> Any:
    if channel.qos is None:
        raise InputError(f"{channel.topic}: its offered_qos_profiles cannot be read")
    described: dict[str, Any] = {"typestore": typestore()}
    if channel.definition and channel.type_hash:
        described = {"msgdef": channel.definition, "rihs01": channel.type_hash}
    return writer.add_connection(
        channel.topic,
        channel.type_name,
        serialization_format=channel.encoding,
        offered_qos_profiles=channel.qos,
        **described,
    )
