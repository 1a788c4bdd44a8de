"""Index of the chunks of a sound MCAP file, read from its end by the mcap library."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
import zlib

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics
from mcap.stream_reader import StreamReader

from evpinn_ros.bags.limits import LONGEST_CHUNK, most_messages
from evpinn_ros.bags.mcap_content import (
    FOOTER,
    HEAD,
    INDEX_ENTRY,
    INDEX_HEAD,
    LENGTH,
    MAGIC,
    PARSE_ERRORS,
    Block,
    Definitions,
)
from evpinn_ros.bags.mcap_scan import McapScan
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import FileBytes, most_unpacked
from evpinn_ros.common.units import MEBIBYTE

LARGEST_SUMMARY = 64 * MEBIBYTE  # that of 500 000 chunks; with a larger one the file is searched


@dataclass(slots=True)
class SoundFile:
    """Facts of a file that are known before its messages are read."""

    definitions: Definitions  # of schemas and channels
    counts: Counter[int]  # messages by channel id
    blocks: list[Block]  # where the messages lie
    notes: list[str] = field(default_factory=list)  # what is wrong with the file, in words
    lost_chunks: int = 0  # damaged ones that are in no block


@dataclass(slots=True)
class FileSummary:
    """Summary at the end of a file; of a damaged one, as far as it can be read."""

    start: int = 0  # where it begins
    ended: bool = False  # the file has its end
    definitions: Definitions = field(default_factory=Definitions)  # of schemas and channels
    statistics: Statistics | None = None  # what the file counted, or None
    chunks: list[ChunkIndex] = field(default_factory=list)  # the index of the chunks


def sound_file(file: FileBytes) -> SoundFile | None:
    """Read the summary at a file's end; None when anything there is missing, or contradicts.

    The checksum of the summary must hold, and the records before it must follow each other from
    chunk to chunk as it says; the checksum of a chunk is looked at when that is read.
    """
    try:
        summary = summary_of(file)
        blocks = _blocks(file, summary.chunks, summary.start)
    except InputError:  # a bad sector there: what is before it can be read
        return None
    known, statistics = summary.definitions, summary.statistics
    if (
        blocks is None
        or statistics is None
        or len(known.channels) != statistics.channel_count
        or not all(map(known.knows, statistics.channel_message_counts))
        or sum(block.count for block in blocks) != statistics.message_count
        or statistics.message_count > most_messages(file.size)
        or sum(block.head.size for block in blocks if block.head) > most_unpacked(file.size)
    ):
        return None
    return SoundFile(known, Counter(statistics.channel_message_counts), blocks)


def summary_of(file: FileBytes) -> FileSummary:
    """Read the end of a file; nothing of it when its checksum does not hold.

    Raises:
        InputError: it cannot be read from the disk.
    """
    found = FileSummary()
    at = file.size - len(MAGIC) - FOOTER.size - HEAD.size
    tail = file.read(max(at, 0), file.size)
    if at < len(MAGIC) or tail[-len(MAGIC) :] != MAGIC:
        return found
    if HEAD.unpack_from(tail) != (Opcode.FOOTER, FOOTER.size):
        return found
    start, _, checksum = FOOTER.unpack_from(tail, HEAD.size)
    found.ended = start == 0
    if not len(MAGIC) <= start < at or file.size - start > LARGEST_SUMMARY:
        return found
    data = file.read(start, file.size - start)
    if checksum and zlib.crc32(data[: at + HEAD.size + 2 * LENGTH.size - start]) != checksum:
        return found
    found.start, found.ended = start, True
    # A chunk has no business in a summary: it stays packed.
    records = StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True).records
    with suppress(MemoryError, OverflowError, *PARSE_ERRORS):
        for record in records:
            if isinstance(record, Schema):
                found.definitions.schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                found.definitions.channels.setdefault(record.id, record)
            elif isinstance(record, Statistics):
                found.statistics = record
            elif isinstance(record, ChunkIndex):
                found.chunks.append(record)
    return found


def _blocks(file: FileBytes, chunks: list[ChunkIndex], end: int) -> list[Block] | None:
    """The chunks of the data section; None when its records do not lead from one to the next."""
    indexed = {chunk.chunk_start_offset: chunk for chunk in chunks}
    scan, blocks = McapScan(file, Definitions()), []
    position = len(MAGIC)
    while position < end:
        chunk = indexed.pop(position, None)
        head = scan.head(position)
        if head is None or head[1] > end or (head[0] == Opcode.CHUNK) != (chunk is not None):
            return None
        opcode, position_after = head
        if opcode == Opcode.MESSAGE:
            return None  # outside of any chunk
        if chunk is not None:
            chunk_head = scan.chunk(position, position_after)
            heads = (INDEX_HEAD + HEAD.size) * len(chunk.message_index_offsets)
            count = (chunk.message_index_length - heads) // INDEX_ENTRY
            # By mistake or not, other lengths lead elsewhere.
            if chunk_head is None or chunk_head.packed != chunk.compressed_size or count < 0:
                return None
            if max(chunk_head.size, chunk_head.packed) > LONGEST_CHUNK:
                return None
            # Its time is taken from the index, which a checksum guards.
            blocks.append(
                Block(
                    chunk.message_start_time, chunk_head.first, position_after, chunk_head, count
                )
            )
            position_after += chunk.message_index_length
        position = position_after
    return blocks if position == end and not indexed else None
