"""Search for recorded drives: bags, CAN logs and tables below a folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from evpinn_ros.bags.can_frames import BAG_SUFFIXES
from evpinn_ros.can.logs import LOG_SUFFIXES
from evpinn_ros.drives.formats import TABLE_SUFFIXES, suffix_of

TABLES = tuple(suffix for suffix in TABLE_SUFFIXES if suffix != ".txt")  # most are a read-me


def recordings(path: Path) -> Iterator[Path]:
    """The recordings at or below a path, in no order; a file is taken for one, whatever it is.

    Raises:
        OSError: a folder cannot be read.
    """
    if path.is_file() or is_bag_folder(path):
        yield path
        return
    for inner in path.iterdir():
        if inner.is_dir():
            yield from recordings(inner)
        elif suffix_of(inner) in (*BAG_SUFFIXES, *LOG_SUFFIXES, *TABLES):
            yield inner


def is_bag_folder(path: Path) -> bool:
    """True if a folder is one bag, as rosbag2 writes it; a killed recorder left no metadata.

    Other folders with bag files hold as many bags.

    Raises:
        OSError: it cannot be read.
    """
    if (path / "metadata.yaml").is_file():
        return True
    names = (each.name for each in path.iterdir() if each.suffix in BAG_SUFFIXES)
    return any(name.startswith(f"{path.name}_") for name in names)
