"""Files that are files: a named pipe would be waited for, and a device read for ever."""

from __future__ import annotations

import errno
import os
from pathlib import Path
import stat
from typing import BinaryIO


def open_file(path: Path) -> BinaryIO:
    """A file, to be read as bytes.

    Raises:
        OSError: it cannot be opened, or is something else than a file.
        ValueError: no file can have such a name.
    """
    return open(path, "rb", opener=_open)


def _open(path: str, flags: int) -> int:
    descriptor = os.open(path, flags | os.O_NONBLOCK)  # a pipe without a writer opens at once
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode) or stat.S_ISDIR(mode):  # of a folder Python says it better
        return descriptor
    os.close(descriptor)
    raise OSError(errno.EINVAL, "a pipe or a device, no file", path)
