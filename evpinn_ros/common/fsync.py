"""Files that are whole or not there: after a loss of power, a kill, on a full disk."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
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


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """A draft that takes the place of a file when it is whole; of one that is not nothing stays.

    What is no file, such as a pipe, is written to as it is.

    Args:
        path: of the file.

    Yields:
        Path of the draft.
    """
    target = path.resolve()
    if target.exists() and not target.is_file():
        yield target
        return
    draft = target.with_name(f"{target.name}.new")
    try:
        yield draft
        draft.replace(target)
    except BaseException:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise
