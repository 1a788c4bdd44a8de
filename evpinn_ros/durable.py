"""What outlives a loss of power: content that was synced, under a name that was."""

from __future__ import annotations

from contextlib import suppress
import os
from pathlib import Path


def sync(path: Path) -> None:
    """Put the content of a file, or the names in a folder, on the disk, as far as it can be."""
    with suppress(OSError):  # some file systems do not sync folders
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
