"""Limits on the unpacked size of the parts of a bag, whatever lengths the file claims."""

from __future__ import annotations

from typing import BinaryIO, cast

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
import zstandard

from evpinn_ros.common.units import MEBIBYTE

LONGEST_CHUNK = 40 * MEBIBYTE
"""Bytes of a chunk (packed or unpacked), of a message and of an attachment. Recorders write chunks
of 1 MB; a longer message gets a chunk of its own. `evpinn recover` holds three chunks."""

LONGEST_MESSAGE = 16 * MEBIBYTE
"""Bytes of a message that is decoded; our largest, a plan of 50 000 points, has 8 MB."""

LARGEST_SUMMARY = 64 * MEBIBYTE
"""Bytes of the summary of an MCAP file, enough for 500 000 chunks. If it is larger, its index is
not used."""

MOST_DEFINITIONS = 8 * MEBIBYTE
"""Bytes of all schemas and channels of a file together."""

LARGEST_WINDOW = 64 * MEBIBYTE
"""Bytes of unpacked data that zstd may keep: a chunk, or the window of most levels."""

MOST_HELD = 64 * MEBIBYTE
"""Bytes of messages held back to sort them by time. A recorder's chunks overlap by seconds."""


def zstd_reader(source: bytes | BinaryIO) -> zstandard.ZstdDecompressionReader:
    """Decompressing reader; it raises ZstdError for damaged data or too large a window."""
    decompressor = zstandard.ZstdDecompressor(max_window_size=LARGEST_WINDOW)
    return decompressor.stream_reader(source, read_across_frames=True)


def unpacked(compression: str, data: bytes, size: int) -> bytes:
    """Unpack a chunk of `size` bytes, or a cut one; ValueError if damaged or above the limit."""
    if max(size, len(data)) > LONGEST_CHUNK:
        raise ValueError(f"above the limit of {LONGEST_CHUNK // MEBIBYTE} MiB")
    try:
        if compression == "zstd":
            data = zstd_reader(data).read(size + 1)
        elif compression == "lz4":
            data = cast(bytes, LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise ValueError("damaged") from error
    if compression not in ("", "zstd", "lz4") or len(data) > size:
        raise ValueError("damaged")
    return data
