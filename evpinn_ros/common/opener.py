"""The one way in: every file from outside is opened here, and nothing but a file.

A named pipe would be waited for, a device read for ever. Parsers are bounded here: bytes of a
file, its ratio, characters of a line. A foreign one whose format can lie runs apart
(`common.sandbox`). What was opened is remembered, so that no output is written over it
(`common.writer`).
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
"""Characters of a line of text, one without an end would fill the memory: a frame of CAN FD takes
200, a row of a wide table 10 000."""
MOST_COLUMNS = 10_000  # of a table
RATIO, FREE_BYTES = 200, 1 << 20
_files: dict[tuple[int, int], tuple[Path, bool]] = {}
"""Name of every file that this process opened or wrote, by device and number; whether it wrote it.
"""


def most_unpacked(size: int) -> int:
    """Bytes that so many packed ones may unpack to; bags shrink to a hundredth at most."""
    return FREE_BYTES + RATIO * size


def open_file(path: Path) -> BinaryIO:
    """A file as bytes; OSError if it cannot be opened or is none, ValueError for its name."""
    return open(path, "rb", opener=_open)


def open_unpacked(path: Path) -> IO[bytes]:
    """A file, unpacked if it is a `.gz`; where it unpacks to too much, reading raises OSError."""
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
    """Bytes of a file that a library will open; InputError if it is none."""
    with as_input_error(path, ValueError), open_file(path) as file:
        return os.fstat(file.fileno()).st_size


def input_at(path: Path) -> Path | None:
    """The name of the input that a path leads to, if this process has opened it, or None."""
    with suppress(OSError, ValueError):
        status = path.stat()
        if (named := _named(status)) is not None and not named[1]:
            return named[0]
    return None


def note_own(path: Path) -> None:
    """Remember that this process wrote a file, which is no input then."""
    status = path.stat()
    _files[status.st_dev, status.st_ino] = path.absolute(), True


def _named(status: os.stat_result) -> tuple[Path, bool] | None:
    """What is known of a file; the number of one that is gone is given to another."""
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
    if stat.S_ISDIR(status.st_mode):  # of which Python says it better
        return descriptor
    os.close(descriptor)
    raise OSError(errno.EINVAL, "a pipe or a device, no file", path)


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
