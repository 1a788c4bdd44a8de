"""The records of an MCAP file, read from its bytes: https://mcap.dev/spec.

The reader of the mcap library stops at the first damaged byte; these functions let
`evpinn_ros.bags.mcap_file` go on behind it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
import mmap
import struct
from typing import Any, TypeAlias
import zlib

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader
import zstandard

# What is unpacked at once. rosbag2 writes chunks of 1 MB by default; a longer message has a chunk
# of its own, and no message of ours is that long.
LARGEST_CHUNK = 64 << 20
LARGEST_SUMMARY = 64 << 20  # that of 500 000 chunks; with a larger one the file is searched
MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # opcode, bytes that follow
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; then data
CHUNK = struct.Struct("<QQQII")  # first and last log time, size, checksum, bytes of next string
LENGTH = struct.Struct("<Q")
FOOTER = struct.Struct("<QQI")  # start of summary, start of its offsets, checksum of summary
FILE_END = HEAD.size + FOOTER.size + len(MAGIC)
PARSE_ERRORS = (McapError, struct.error, ValueError, LookupError, MemoryError, OverflowError)

Bytes: TypeAlias = bytes | mmap.mmap


class DamagedError(Exception):
    """Bytes are not what was written."""


@dataclass(frozen=True, slots=True)
class Block:
    """A stretch of the file that holds message records: a chunk, or the whole data section.

    Attributes:
        start_ns: log time of its first message.
        begin: first byte of its (compressed) records.
        end: behind their last byte.
        compression: `zstd`, `lz4` or empty.
        size: bytes of its records when unpacked; None when the chunk is cut, or not a chunk.
        checksum: CRC-32 of its records when unpacked; 0 is none.
    """

    start_ns: int
    begin: int
    end: int
    compression: str = ""
    size: int | None = None
    checksum: int = 0


def records(data: Bytes, position: int = 0) -> Iterator[tuple[int, int, int]]:
    """Opcode, begin and end of each whole record; stops where one is cut or its length wrong."""
    while position + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, position)
        begin = position + HEAD.size
        position = begin + length
        if position > len(data):
            return
        yield opcode, begin, position


def chunk_at(data: Bytes, position: int) -> Block:
    """The chunk whose record starts here; the file may be cut inside it.

    Raises:
        DamagedError: no chunk starts here.
    """
    try:
        opcode, length = HEAD.unpack_from(data, position)
        begin = position + HEAD.size
        start_ns, _, size, checksum, name_length = CHUNK.unpack_from(data, begin)
        name_end = begin + CHUNK.size + name_length
        compression = bytes(data[begin + CHUNK.size : name_end]).decode()
        (packed,) = LENGTH.unpack_from(data, name_end)
    except (struct.error, UnicodeDecodeError) as error:
        raise DamagedError("no chunk") from error
    first = name_end + LENGTH.size
    end = first + packed
    if opcode != Opcode.CHUNK or end != begin + length:
        raise DamagedError("no chunk")
    if end > len(data):
        return Block(start_ns, first, len(data), compression)
    return Block(start_ns, first, end, compression, size, checksum)


def unpacked(data: Bytes, block: Block) -> bytes:
    """The records of a block, of a cut one as far as they go.

    Raises:
        DamagedError: they do not unpack, the size or checksum is wrong, or there are more than
            `LARGEST_CHUNK` bytes of them.
    """
    if max(block.size or 0, block.end - block.begin) > LARGEST_CHUNK:
        raise DamagedError(f"larger than {LARGEST_CHUNK} bytes")
    packed = data[block.begin : block.end]
    try:
        if block.compression == "":
            content = packed
        elif block.compression == "zstd":
            content = zstandard.ZstdDecompressor().stream_reader(packed).read(LARGEST_CHUNK + 1)
        elif block.compression == "lz4":
            content = LZ4FrameDecompressor().decompress(packed, LARGEST_CHUNK + 1)
        else:
            raise DamagedError(f"unknown compression {block.compression!r}")
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise DamagedError(str(error)) from error
    if len(content) > LARGEST_CHUNK:
        raise DamagedError(f"larger than {LARGEST_CHUNK} bytes")
    if block.size is not None:
        if len(content) != block.size:
            raise DamagedError(f"{len(content)} bytes instead of {block.size}")
        if block.checksum and zlib.crc32(content) != block.checksum:
            raise DamagedError("wrong checksum")
    return content


def has_end(data: Bytes) -> bool:
    """Whether the file was closed: it has a footer and the end mark."""
    if len(data) < len(MAGIC) + FILE_END or data[-len(MAGIC) :] != MAGIC:
        return False
    return HEAD.unpack_from(data, len(data) - FILE_END) == (Opcode.FOOTER, FOOTER.size)


def summary_records(data: Bytes) -> list[Any]:
    """The records of the summary, those of `mcap.records`; empty when absent or damaged."""
    if not has_end(data):
        return []
    body = len(data) - FILE_END + HEAD.size
    start, _, checksum = FOOTER.unpack_from(data, body)
    if not len(MAGIC) <= start < body or body - start > LARGEST_SUMMARY:
        return []
    if checksum and zlib.crc32(data[start : body + 2 * LENGTH.size]) != checksum:
        return []
    try:
        # A chunk has no business in a summary: it stays packed.
        return list(StreamReader(BytesIO(data[start:]), skip_magic=True, emit_chunks=True).records)
    except PARSE_ERRORS:
        return []
