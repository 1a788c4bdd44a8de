"""Names by which a bag is known: what tells files apart need not read them."""

from pathlib import Path

BAG_SUFFIXES = (".mcap", ".db3")
PACKED = ".zstd"


def is_bag(path: Path) -> bool:
    """True if a path is a bag's by its looks."""
    return path.is_dir() or path.name.removesuffix(PACKED).endswith(BAG_SUFFIXES)
