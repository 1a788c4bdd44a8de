"""Recognises bags by name, without importing their reader."""

from pathlib import Path

BAG_SUFFIXES = (".mcap", ".db3")
PACKED = ".zstd"


def is_bag(path: Path) -> bool:
    """True for any folder, and for a file with a bag's suffix; the content is not read."""
    return path.is_dir() or path.name.removesuffix(PACKED).endswith(BAG_SUFFIXES)
