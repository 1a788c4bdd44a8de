"""Short names of drives in tables and charts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from evpinn_ros.can.log_names import LOG_SUFFIXES
from evpinn_ros.logs.formats import TABLE_SUFFIXES, suffix_of


def short_names(paths: Sequence[Path]) -> tuple[str, ...]:
    """A name for each drive: that of its file, with suffix and folder if needed to be unique."""
    whole = [path.absolute() for path in paths]
    bare = [_bare(path) for path in whole]
    if len(set(bare)) == len(bare):
        return tuple(bare)
    for length in range(1, 1 + max(len(path.parts) for path in whole)):
        names = ["/".join(path.parts[-length:]) for path in whole]
        if len(set(names)) == len(names):
            return tuple(names)
    return tuple(f"{number}: {path.name}" for number, path in enumerate(whole, start=1))


def _bare(path: Path) -> str:
    """Name of a file without the suffixes of its format."""
    suffix = suffix_of(path)
    if suffix not in (*TABLE_SUFFIXES, *LOG_SUFFIXES):
        return path.name
    name = path.name
    for ending in (".gz", suffix):
        if name.lower().endswith(ending.lower()):
            name = name[: len(name) - len(ending)]
    return name
