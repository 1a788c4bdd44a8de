"""Unpacking of MCAP chunks: never to more than a chunk states, nor than the limit."""

from __future__ import annotations

from typing import cast

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
import zstandard

from evpinn_ros.bags.limits import LONGEST_CHUNK
from evpinn_ros.common.units import MEBIBYTE


def unpacked(compression: str, data: bytes, size: int) -> bytes:
    """The content of a chunk that states `size` bytes; of a cut chunk what there is of it.

    Raises:
        ValueError: above the limit, refused before it is unpacked; damaged, or more than stated.
    """
    if max(size, len(data)) > LONGEST_CHUNK:
        raise ValueError(f"above the limit of {LONGEST_CHUNK // MEBIBYTE} MiB")
    try:
        if compression == "zstd":
            reader = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True)
            data = reader.read(size + 1)
        elif compression == "lz4":
            data = cast(bytes, LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise ValueError("damaged") from error
    if compression not in ("", "zstd", "lz4") or len(data) > size:
        raise ValueError("damaged")
    return data
