"""Reads the records of an MCAP file from its start; the mcap library parses them.

Damaged chunks are skipped; after a damaged record, reading resumes at the next indexed chunk.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
import os
import struct
from typing import Any, BinaryIO, TypeAlias
import zlib

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    ChunkIndex,
    Message,
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from evpinn_ros.bags.limits import LARGEST_SUMMARY, LONGEST_CHUNK, MOST_DEFINITIONS, unpacked
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import RATIO, most_unpacked
from evpinn_ros.common.units import MEBIBYTE

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # opcode, length of the body
FOOTER = struct.Struct("<QQI")  # start of the summary, start of its offsets, its checksum
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; data follow
INDEX_HEAD, INDEX_ENTRY = 6, 16  # bytes of a message index
PRIVATE = 0x80  # first opcode for private use
PARSE_ERRORS = (McapError, struct.error, ValueError, LookupError, MemoryError, OverflowError)
_ENDS: dict[int, int] = {Opcode.DATA_END: 4, Opcode.FOOTER: FOOTER.size}
_PARSED: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}


@dataclass(slots=True)
class Loss:
    """Bytes of a file that cannot be read."""

    begin: int  # first byte
    end: int  # byte after the last one
    reason: str  # in a few words
    chunk: bool = False  # True if the bytes are one chunk
    messages: int | None = None  # lost with them; None if unknown
    after_ns: int | None = None  # log time of the newest message before, None if none
    before_ns: int | None = None  # log time of the next message, None if none


McapItem: TypeAlias = Message | Loss | Attachment | Metadata


@dataclass(slots=True)
class McapSummary:
    """Summary at the end of a file; empty if the end is missing or damaged."""

    ended: bool = False  # True if the end of the file is present
    content: Summary = field(default_factory=Summary)

    @property
    def indexes_all(self) -> bool:
        """True if the chunk index covers every message that the file counts."""
        statistics, chunks = self.content.statistics, self.content.chunk_indexes
        heads = INDEX_HEAD + HEAD.size
        indexed = sum(
            (chunk.message_index_length - heads * len(chunk.message_index_offsets)) // INDEX_ENTRY
            for chunk in chunks
        )
        return bool(chunks) and statistics is not None and indexed == statistics.message_count

    def within_limits(self, size: int) -> bool:
        """True if the chunks fit into the file and unpack to no more than the limits."""
        chunks = self.content.chunk_indexes
        return (
            all(chunk.uncompressed_size <= LONGEST_CHUNK for chunk in chunks)
            and sum(chunk.uncompressed_size for chunk in chunks) <= most_unpacked(size)
            and sum(chunk.compressed_size for chunk in chunks) <= size
        )


class McapRecords:
    """One pass over a file; it keeps at most one chunk in memory."""

    def __init__(self, file: BinaryIO, name: object) -> None:
        self._file, self._name = file, name
        self.size = os.fstat(file.fileno()).st_size
        self.summary = McapSummary()
        with suppress(InputError):  # a bad sector there: records before it can be read
            self.summary = self._summary()
        content = self.summary.content
        self.schemas, self.channels = dict(content.schemas), dict(content.channels)
        self.stated = content.statistics.message_count if content.statistics else None
        self.ended = self.summary.ended  # the file has its end
        self.chunks = self.unknown = 0  # chunks seen; messages without a topic definition
        self.position, self.proven = 0, False
        self._starts = sorted(chunk.chunk_start_offset for chunk in content.chunk_indexes)
        self._bytes_left, self._definitions_left = most_unpacked(self.size), MOST_DEFINITIONS

    def __iter__(self) -> Iterator[McapItem]:
        """Messages, attachments, metadata, losses in file order; InputError if the disk fails."""
        self.position = len(MAGIC)  # first byte after the last record
        lost: Loss | None = None  # the last lost chunk, while message indexes after it are counted
        while self.position < self.size:
            begin = self.position
            opcode, end, body = self._record(begin)
            if body is None or end > self.size:
                yield from self._broken(begin, opcode, end, body)
                continue
            if len(body) == _ENDS.get(opcode):
                return
            self.position = end
            if lost is not None and opcode == Opcode.MESSAGE_INDEX:
                lost.messages = (lost.messages or 0) + (len(body) - INDEX_HEAD) // INDEX_ENTRY
                continue
            for item in self._items(opcode, body, begin, end):
                lost = item if isinstance(item, Loss) else None
                yield item

    def _read(self, begin: int, length: int) -> bytes:
        try:
            self._file.seek(begin)
            return self._file.read(length)
        except OSError as error:
            raise InputError(
                f"{self._name}: {error.strerror} in {length} bytes from byte {begin}; "
                "copy the disk with ddrescue first"
            ) from error

    def _record(self, begin: int) -> tuple[int, int, bytes | None]:
        """Opcode, end and body of the record at `begin`; body None if the header is invalid."""
        head = self._read(begin, HEAD.size)
        if len(head) < HEAD.size:
            return 0, self.size + 1, head
        opcode, length = HEAD.unpack(head)
        end = begin + HEAD.size + length
        if not opcode or length > LONGEST_CHUNK:
            return opcode, end, None
        return opcode, end, self._read(begin + HEAD.size, min(length, self.size))

    def _broken(self, begin: int, opcode: int, end: int, body: bytes | None) -> Iterator[McapItem]:
        """Yield the rest of a cut or damaged record; continue at the next indexed chunk."""
        index = bisect_right(self._starts, begin)
        self.position = self._starts[index] if index < len(self._starts) else self.size
        is_chunk = opcode == Opcode.CHUNK
        if body is not None and self.position == self.size:
            if is_chunk:
                yield from self._chunk(body, begin, self.size, cut=True)
            else:
                yield Loss(begin, self.size, "cut")
            return
        reason = "damaged"
        if body is None and opcode and end <= self.size:
            self.position, reason = end, f"above the limit of {LONGEST_CHUNK // MEBIBYTE} MiB"
        self.chunks += is_chunk
        yield Loss(begin, self.position, reason, is_chunk)

    def _items(self, opcode: int, body: bytes, begin: int, end: int) -> Iterator[McapItem]:
        try:
            if opcode == Opcode.CHUNK:
                yield from self._chunk(body, begin, end)
            elif opcode == Opcode.MESSAGE:
                self.proven = False
                yield from self._message(body, 0, len(body))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(opcode, body)
            elif opcode == Opcode.METADATA:
                yield _parsed(opcode, body)
            elif opcode == Opcode.ATTACHMENT:
                (checksum,) = struct.unpack("<I", body[-4:])
                if checksum not in (0, zlib.crc32(body[:-4])):
                    raise ValueError("damaged")
                yield _parsed(opcode, body)
            elif opcode == Opcode.MESSAGE_INDEX:
                if struct.unpack_from("<I", body, 2) != (len(body) - INDEX_HEAD,):
                    raise ValueError("damaged")
            elif opcode < PRIVATE and begin > len(MAGIC):  # the header comes first
                raise ValueError("damaged")
        except PARSE_ERRORS:
            yield Loss(begin, end, "damaged")

    def _chunk(self, body: bytes, begin: int, end: int, cut: bool = False) -> Iterator[McapItem]:
        """The messages of a chunk; of a cut chunk, those before the cut."""
        self.chunks += 1
        try:
            chunk = _parsed(Opcode.CHUNK, body)
            if chunk.uncompressed_size > self._bytes_left:
                raise ValueError(f"the file unpacks to over {RATIO} times its size")
            self._bytes_left -= chunk.uncompressed_size
            content = unpacked(chunk.compression, chunk.data, chunk.uncompressed_size)
            checksum = chunk.uncompressed_crc
            if not cut and len(content) != chunk.uncompressed_size:
                raise ValueError("damaged")
            if not cut and checksum and checksum != zlib.crc32(content):
                raise ValueError("damaged")
        except PARSE_ERRORS as error:
            reason = str(error) if type(error) is ValueError else "damaged"
            yield Loss(begin, end, "cut" if cut else reason, chunk=True)
            return
        self.proven = checksum != 0 and not cut  # a checksum covers the newest message
        at = 0
        while at + HEAD.size <= len(content):
            opcode, length = HEAD.unpack_from(content, at)
            first, behind = at + HEAD.size, at + HEAD.size + length
            if not opcode or behind > len(content):
                break
            try:
                if opcode == Opcode.MESSAGE:
                    yield from self._message(content, first, behind)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._define(opcode, content[first:behind])
            except PARSE_ERRORS:
                break
            at = behind
        if cut or at < len(content):
            yield Loss(begin, end, "cut" if cut else "damaged inside", chunk=True)

    def _message(self, content: bytes, first: int, behind: int) -> Iterator[Message]:
        """The message in these bytes, copied only once: a message may fill a chunk."""
        if behind - first < MESSAGE.size:
            raise ValueError("damaged")
        channel_id, sequence, log_time, publish_time = MESSAGE.unpack_from(content, first)
        data = content[first + MESSAGE.size : behind]
        message = Message(channel_id, log_time, data, publish_time, sequence)
        channel = self.channels.get(message.channel_id)
        # By the specification, schema id 0 means that a channel has no schema.
        if channel is None or (channel.schema_id and channel.schema_id not in self.schemas):
            self.unknown += 1
        else:
            yield message

    def _define(self, opcode: int, body: bytes) -> None:
        record = _parsed(opcode, body)
        definitions = self.schemas if opcode == Opcode.SCHEMA else self.channels
        if record.id not in definitions:
            self._definitions_left -= len(body)
            if self._definitions_left < 0:
                raise ValueError("too many topics")
            definitions[record.id] = record

    def _summary(self) -> McapSummary:
        """Read the summary at the end of the file; it is empty if its checksum does not match."""
        summary = McapSummary()
        at = self.size - len(MAGIC) - FOOTER.size - HEAD.size
        tail = self._read(max(at, 0), HEAD.size + FOOTER.size + len(MAGIC))
        if at < len(MAGIC) or tail[-len(MAGIC) :] != MAGIC:
            return summary
        if HEAD.unpack_from(tail) != (Opcode.FOOTER, FOOTER.size):
            return summary
        start, _, checksum = FOOTER.unpack_from(tail, HEAD.size)
        summary.ended = start == 0
        if not len(MAGIC) <= start < at or self.size - start > LARGEST_SUMMARY:
            return summary
        data = self._read(start, self.size - start)
        if checksum and zlib.crc32(data[: at + HEAD.size + 16 - start]) != checksum:
            return summary
        summary.ended, left = True, MOST_DEFINITIONS
        # Chunks do not belong in a summary: they stay packed.
        records = StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True).records
        with suppress(*PARSE_ERRORS):
            for record in records:
                match record:
                    case Schema():
                        summary.content.schemas.setdefault(record.id, record)
                        left -= len(record.data)
                    case Channel():
                        summary.content.channels.setdefault(record.id, record)
                    case ChunkIndex():
                        summary.content.chunk_indexes.append(record)
                    case Statistics():
                        summary.content.statistics = record
        return summary if left >= 0 else McapSummary(ended=True)


def _parsed(opcode: int, body: bytes) -> Any:
    return _PARSED[opcode].read(ReadDataStream(BytesIO(body)))
