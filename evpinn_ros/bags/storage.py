"""A rosbag2 bag in the other storage: MCAP to sqlite3 and back, every topic as it is."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from itertools import takewhile
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from evpinn_ros.bags.metadata import VERSION
from evpinn_ros.bags.rosbags_file import READ_ERRORS, journals, merged
from evpinn_ros.bags.types import typestore
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.progress import reported


class Storage(str, Enum):
    """Storage format of a rosbag2 bag."""

    MCAP = "mcap"
    SQLITE3 = "sqlite3"


def change_storage(
    source: Path,
    out: Path,
    storage: Storage,
    progress: Callable[[float], None] | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """Write a sound bag, byte for byte, into a new one; returns how many messages.

    `progress` takes seconds of the recording; `stopped` ends it with a whole bag. InputError: the
    bag is broken (`evpinn recover` saves MCAP), or `out` cannot be written.
    """
    if out.exists():
        raise InputError(f"{out}: there already; give the name of a new folder")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with (
            TemporaryDirectory(prefix="evpinn-") as folder,
            Reader(_with_journals(source, Path(folder))) as reader,
        ):
            return _copy(reader, out, storage, progress, stopped)
    except InputError:
        raise
    except READ_ERRORS as error:
        reason = " ".join(str(error).replace(str(source), "").split())
        raise InputError(
            f"{source} to {out}: {reason}; evpinn recover saves a broken MCAP"
        ) from error


def _with_journals(source: Path, folder: Path) -> Path:
    if source.is_dir():
        for database in source.glob("*.db3"):
            if beside := journals(database.resolve()):
                names = ", ".join(journal.name for journal in beside)
                raise InputError(f"{source}: {names} holds messages too; give {database}")
        return source
    is_open = source.suffix == ".db3" and source.is_file() and journals(source.resolve())
    return merged(source.resolve(), folder) if is_open else source


def _copy(
    reader: Reader,
    out: Path,
    storage: Storage,
    progress: Callable[[float], None] | None,
    stopped: Callable[[], bool],
) -> int:
    count = 0
    with Writer(out, version=VERSION, storage_plugin=StoragePlugin[storage.name]) as writer:
        new = {connection.id: _connect(writer, connection) for connection in reader.connections}
        messages = takewhile(lambda _: not stopped(), reader.messages())
        for connection, log_time_ns, data in reported(messages, progress, itemgetter(1)):
            writer.write(new[connection.id], log_time_ns, data)
            count += 1
    return count


def _connect(writer: Writer, connection: Any) -> Any:
    definition = connection.msgdef.data
    described: dict[str, Any] = {"typestore": typestore()}
    if definition and connection.digest:
        described = {"msgdef": definition, "rihs01": connection.digest}
    return writer.add_connection(
        connection.topic,
        connection.msgtype,
        serialization_format=connection.ext.serialization_format,
        offered_qos_profiles=connection.ext.offered_qos_profiles,
        **described,
    )
