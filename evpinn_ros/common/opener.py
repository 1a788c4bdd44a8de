"""Opens every input file of the package, and refuses anything but a regular file.

A named pipe would block, and a device never ends. Parsers limit the bytes of a file, the ratio of
compression and the characters of a line. Foreign parsers of unsafe formats run in
`common.sandbox`. Opened files are remembered, so that `common.writer` does not overwrite them.
"""

from __future__ import annotations

from contextlib import suppress
import errno
import gzip
import io
import os
from pathlib import Path
import stat
from typing import IO, BinaryIO, cast

from evpinn_ros.common.errors import InputError, as_input_error

LONGEST_LINE = 1_000_000
"""Characters of a line of text: an endless line would fill the memory. A frame of CAN FD takes
200, a row of a wide table 10 000."""
MOST_COLUMNS = 10_000  # of a table
RATIO, FREE_BYTES = 200, 1 << 20
_files: dict[tuple[int, int], tuple[Path, bool]] = {}
"""Path of every file that this process opened or wrote, by device and inode; True if it wrote it.
"""


def most_unpacked(size: int) -> int:
    """Most bytes that a packed file of `size` bytes may unpack to; bags shrink by at most 100."""
    return FREE_BYTES + RATIO * size


def open_file(path: Path) -> BinaryIO:
    """Open a file to read bytes; OSError if not readable or regular, ValueError for a bad name."""
    return open(path, "rb", opener=_open)


def open_unpacked(path: Path) -> IO[bytes]:
    """Open a file, unpacked if `.gz`; reading raises OSError beyond `most_unpacked` bytes."""
    if path.suffix.lower() != ".gz":
        return open_file(path)
    return cast(IO[bytes], io.BufferedReader(_BoundedGzip(path), 1 << 16))


def read_whole(path: Path, most: int, what: str) -> bytes:
    """All bytes of a small file; FileNotFoundError, or InputError if larger than `most`."""
    try:
        with open_file(path) as file:
            content = file.read(most + 1)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    if len(content) > most:
        raise InputError(f"{path}: larger than {most} bytes, not {what}")
    return content


def check_file(path: Path) -> int:
    """Size in bytes of a file that a library will open; InputError if it is not a regular file."""
    with as_input_error(path, ValueError), open_file(path) as file:
        return os.fstat(file.fileno()).st_size


def input_at(path: Path) -> Path | None:
    """Path under which this process has read the same file; None if it has not."""
    with suppress(OSError, ValueError):
        status = path.stat()
        if (named := _named(status)) is not None and not named[1]:
            return named[0]
    return None


def note_own(path: Path) -> None:
    """Remember that this process wrote a file, so that it does not count as input."""
    status = path.stat()
    _files[status.st_dev, status.st_ino] = path.absolute(), True


def _named(status: os.stat_result) -> tuple[Path, bool] | None:
    """The entry of a file in `_files`, checked: the inode of a deleted file is used again."""
    named = _files.get((status.st_dev, status.st_ino))
    with suppress(OSError):
        if named is not None and os.path.samestat(named[0].stat(), status):
            return named
    return None


def _open(path: str, flags: int) -> int:
    descriptor = os.open(path, flags | os.O_NONBLOCK)  # a pipe without a writer opens at once
    status = os.fstat(descriptor)
    if stat.S_ISREG(status.st_mode):
        if _named(status) is None:
            _files[status.st_dev, status.st_ino] = Path(path).absolute(), False
        return descriptor
    if stat.S_ISDIR(status.st_mode):  # Python's own error is clearer
        return descriptor
    os.close(descriptor)
    raise OSError(errno.EINVAL, "a pipe or a device, not a file", path)


class _BoundedGzip(io.RawIOBase):
    def __init__(self, path: Path) -> None:
        self._packed = open_file(path)
        self._left = most_unpacked(os.fstat(self._packed.fileno()).st_size)
        self._file = gzip.GzipFile(fileobj=self._packed)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        data = self._file.read1(len(buffer))
        self._left -= len(data)
        if self._left < 0:
            raise gzip.BadGzipFile(f"unpacks to over {RATIO} times its size")
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        if not self.closed:
            self._file.close()
            self._packed.close()
        super().close()
