"""Limits on what a bag unpacks to, by its own size, whatever lengths it claims."""

from __future__ import annotations

from typing import BinaryIO, cast

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
import zstandard

from evpinn_ros.common.units import MEBIBYTE

LONGEST_CHUNK = 40 * MEBIBYTE
"""Bytes of a chunk, packed and unpacked, of a message and of an attachment. Recorders write chunks
of 1 MB, and a longer message has one of its own; `evpinn recover` holds three of them."""

LONGEST_MESSAGE = 16 * MEBIBYTE
"""Bytes of a message that is decoded: ours have at most 8 MB, a plan of 50 000 points."""

LARGEST_SUMMARY = 64 * MEBIBYTE
"""Bytes of the end of an MCAP file, that of 500 000 chunks; with a larger one its index is not
used."""

MOST_DEFINITIONS = 8 * MEBIBYTE
"""Bytes of all schemas and channels of a file together."""

LARGEST_WINDOW = 64 * MEBIBYTE
"""Bytes that zstd may hold of what it has unpacked: a chunk, or what most levels look back at."""

MOST_HELD = 64 * MEBIBYTE
"""Bytes of messages held back to put them in order. Chunks of a recorder overlap by seconds."""


def zstd_reader(source: bytes | BinaryIO) -> zstandard.ZstdDecompressionReader:
    """Reads what was packed; ZstdError if that is damaged or of a larger window."""
    decompressor = zstandard.ZstdDecompressor(max_window_size=LARGEST_WINDOW)
    return decompressor.stream_reader(source, read_across_frames=True)


def unpacked(compression: str, data: bytes, size: int) -> bytes:
    """Content of a chunk of `size` bytes, or of a cut one; ValueError, before, above the limit."""
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
