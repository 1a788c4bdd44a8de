"""Limit on what anything packed may unpack to, and gzipped files read within it."""

from __future__ import annotations

import gzip
import io
from pathlib import Path
from typing import IO, cast

from evpinn_ros.common.plain_file import open_file

RATIO, FREE_BYTES = 200, 1 << 20


def most_unpacked(size: int) -> int:
    """Bytes that so many packed bytes may unpack to.

    Drives of real cars shrink to a fifth, a bag in which nothing ever changes to a hundredth.
    """
    return FREE_BYTES + RATIO * size


def open_gzipped(path: Path) -> IO[bytes]:
    """A gzipped file, to be read; where it unpacks to too much reading raises OSError."""
    return cast(IO[bytes], io.BufferedReader(_BoundedGzip(path), 1 << 16))


class _BoundedGzip(io.RawIOBase):
    """Content of a gzipped file, as far as its size allows."""

    def __init__(self, path: Path) -> None:
        self._left = most_unpacked(path.stat().st_size)
        self._packed = open_file(path)
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
