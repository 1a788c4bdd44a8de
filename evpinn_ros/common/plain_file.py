"""Files that are files: a named pipe would be waited for, and a device read for ever."""

from __future__ import annotations

import errno
import os
from pathlib import Path
import stat
from typing import BinaryIO

from evpinn_ros.common.errors import InputError, as_input_error

WINDOW = 4 << 20  # bytes that `FileBytes` reads at once
LONGEST_LINE = 1_000_000
"""Characters of a line of text, one without an end would fill the memory: a frame of CAN FD takes
200, a row of a wide table 10 000."""


def open_file(path: Path, window: int = -1) -> BinaryIO:
    """A file, to be read as bytes, and so many ahead; -1 for some thousand.

    Raises:
        OSError: it cannot be opened, or is something else than a file.
        ValueError: no file can have such a name.
    """
    return open(path, "rb", window, opener=_open)


def _open(path: str, flags: int) -> int:
    descriptor = os.open(path, flags | os.O_NONBLOCK)  # a pipe without a writer opens at once
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode) or stat.S_ISDIR(mode):  # of a folder Python says it better
        return descriptor
    os.close(descriptor)
    raise OSError(errno.EINVAL, "a pipe or a device, no file", path)


class FileBytes:
    """A file read at any place, a window at a time; a map of it would crash on a bad sector."""

    def __init__(self, path: Path) -> None:
        """Open it; InputError when that fails."""
        self.path = path
        with as_input_error(path):
            self._file = open_file(path, WINDOW)
            self.size = path.stat().st_size

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._file.close()

    def read(self, begin: int, length: int) -> bytes:
        """The bytes from here on, fewer at the end of the file."""
        try:
            self._file.seek(begin)
            return self._file.read(max(0, min(length, self.size - begin)))
        except OSError as error:
            raise InputError(
                f"{self.path}: {error.strerror} in {length} bytes from byte {begin}; "
                "copy the disk with ddrescue first"
            ) from error
