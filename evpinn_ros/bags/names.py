"""Recognises bags by name, without importing their reader."""

from pathlib import Path

BAG_SUFFIXES = (".mcap", ".db3")
PACKED = ".zstd"


def is_bag(path: Path) -> bool:
    """True if a path looks like a bag: a folder, or a file with a bag's suffix."""
    return path.is_dir() or path.name.removesuffix(PACKED).endswith(BAG_SUFFIXES)
