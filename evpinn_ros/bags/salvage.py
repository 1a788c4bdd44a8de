"""Pieces of a broken MCAP file that are still whole, and the losses between them.

Chunks prove themselves by their checksum. Records of messages that lie outside of chunks have
none: what is inside them cannot be checked.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
import struct
from typing import TypeAlias
import zlib

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata

from evpinn_ros.bags.limits import LONGEST_CHUNK, most_messages
from evpinn_ros.bags.mcap_content import (
    INDEX_ENTRY,
    MAGIC,
    PARSE_ERRORS,
    Block,
    ChunkHead,
    Definitions,
    Records,
    beginning,
    index_size,
    indexed_records,
    parsed,
    records_in,
    unpacked,
)
from evpinn_ros.bags.mcap_scan import McapScan, summary_of
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import RATIO, FileBytes, most_unpacked
from evpinn_ros.common.units import MEBIBYTE

STRETCH = MEBIBYTE  # messages outside of chunks that are handled together
LOOSE = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
PATIENCE = 1024 * MEBIBYTE, 16  # bytes, and times the file, spent on chunks that prove false


@dataclass(slots=True)
class Piece:
    """Messages that were found."""

    end: int  # behind their last byte in the file
    content: bytes  # their records
    found: Records  # where each message lies in the content
    block: Block  # where to find them again
    # the chunk as it was packed, to be copied as it is; None when a part is missing
    packed: bytes | None = None
    proven: bool = False  # a checksum says that they are what was written


@dataclass(slots=True)
class Loss:
    """Bytes of the file that were given up."""

    begin: int  # first byte
    end: int  # behind the last one
    reason: str  # in a few words
    chunk: bool = False  # the bytes were those of one chunk
    messages: int | None = None  # that were in there, None when nothing tells
    after_ns: int | None = None  # log time of the newest message before, None for none
    before_ns: int | None = None  # log time of the oldest message of the next piece, None for none


Found: TypeAlias = Piece | Loss | Attachment | Metadata


class Salvage:
    """Goes once through a file; memory stays within a few chunks.

    Attributes:
        definitions: schemas and channels known so far.
        ended: the file has its end; complete once iterated.
        stated: messages that the file says it holds, None when it does not.
        unknown: messages whose topic is not known, left out; complete once iterated.
        doubtful: channels that only a damaged chunk described; complete once iterated.
    """

    def __init__(self, file: FileBytes) -> None:
        self.definitions = Definitions()
        self.ended = False
        self.stated: int | None = None
        self.unknown = 0
        self.doubtful: set[str] = set()
        self._file = file
        self._scan = McapScan(file, self.definitions)
        self._doubts = Definitions()
        self._indexed_to = 0  # where the message indexes of the last sound chunk end
        self._patience = PATIENCE[0] + PATIENCE[1] * file.size
        self._bytes_left = most_unpacked(file.size)
        self._messages_left = most_messages(file.size)
        with suppress(InputError):  # a bad sector there: what is before it can be read
            self._read_summary()

    def __iter__(self) -> Iterator[Found]:
        position = len(MAGIC) if self._file.read(0, len(MAGIC)) == MAGIC else 0
        lost: Loss | None = None  # kept back while the message indexes behind it are counted
        while position < self._file.size:
            opcode, end = self._scan.head(position) or (0, position)
            found: list[Found]
            if not self._scan.is_plausible(position):
                found, position = self._gap(position)
            elif opcode == Opcode.MESSAGE_INDEX:
                if lost is not None and position >= self._indexed_to:
                    size = index_size(self._scan.body(position, end))
                    lost.messages = (lost.messages or 0) + size // INDEX_ENTRY
                    lost.chunk = True
                position = end
                continue
            elif opcode in (Opcode.DATA_END, Opcode.FOOTER):
                break
            elif opcode == Opcode.CHUNK:
                found, position = self._chunk(position, end)
            elif opcode in LOOSE:
                found, position = self._loose(position)
            else:
                found, position = self._other(opcode, position, end)
            for each in found:
                if lost is not None:
                    yield lost
                lost = each if isinstance(each, Loss) else None
                if lost is None:
                    yield each
        if lost is not None:
            yield lost

    def _read_summary(self) -> None:
        """Take definitions and counts from behind the messages, where the end tells where."""
        summary = summary_of(self._file)
        self.ended = summary.ended
        self.definitions.complete(summary.definitions)
        if summary.statistics is not None:
            self.stated = summary.statistics.message_count

    def _gap(self, begin: int) -> tuple[list[Found], int]:
        """Loss from a damaged record to the next whole one."""
        opcode, stop = self._scan.head(begin) or (0, self._file.size + 1)
        end = self._scan.next_record(begin + 1)
        if end <= self._indexed_to:
            return [Loss(begin, end, "index damaged", messages=0)], end
        cut = end == self._file.size < stop
        return [Loss(begin, end, "cut" if cut else "damaged", opcode == Opcode.CHUNK)], end

    def _chunk(self, position: int, end: int) -> tuple[list[Found], int]:
        """The messages of a chunk."""
        head = self._scan.chunk(position, end)
        assert head is not None  # it was plausible
        if max(head.size, head.packed) > LONGEST_CHUNK:
            reason = f"above the limit of {LONGEST_CHUNK // MEBIBYTE} MiB"
            return [Loss(position, min(end, self._file.size), reason, chunk=True)], end
        if head.size > self._bytes_left:
            reason = f"the file unpacks to over {RATIO} times its size"
            return [Loss(position, min(end, self._file.size), reason, chunk=True)], end
        self._bytes_left -= head.size
        packed = self._file.read(head.first, head.packed)
        if end > self._file.size:
            return self._cut_chunk(position, head, packed)
        content = unpacked(head, packed)
        if content is None:
            return self._damaged_chunk(position, end, head, packed)
        index, behind = self._scan.message_indexes(end)
        found = indexed_records(content, index, self.definitions) or self._records(content)
        if found.count > self._messages_left:
            return [Loss(position, behind, "the file has too many messages", chunk=True)], behind
        self._messages_left -= found.count
        if index or (self._scan.head(end) or (0, 0))[0] == Opcode.MESSAGE_INDEX:
            self._indexed_to = end + found.index_size
        if found.end == len(content):
            end = behind
            copied = None if found.unknown else packed
            block = _block(head.first, head.first + head.packed, found, head)
            return [Piece(end, content, found, block, copied, head.checksum != 0)], end
        block = _block(head.first, end, found, head)
        return [
            Piece(end, content, found, block),
            Loss(position, end, "damaged inside", True),
        ], end

    def _cut_chunk(self, position: int, head: ChunkHead, packed: bytes) -> tuple[list[Found], int]:
        """The messages of the last chunk of a file that was cut, as far as they go."""
        content, end = beginning(head, packed), self._file.size
        found = self._records(content)
        block = _block(head.first, head.first + head.packed, found, head)
        return [Piece(end, content, found, block), Loss(position, end, "cut", True)], end

    def _damaged_chunk(
        self, position: int, end: int, head: ChunkHead, packed: bytes
    ) -> tuple[list[Found], int]:
        """Give up a chunk; where bytes are missing from it, the next one begins inside it."""
        records_in(beginning(head, packed), self._doubts)
        self._patience -= head.size + head.packed
        if end < self._file.size and not self._scan.is_plausible(end) and self._patience > 0:
            end = min(end, self._scan.next_record(head.first))
        return [Loss(position, end, "damaged", chunk=True)], end

    def _loose(self, position: int) -> tuple[list[Found], int]:
        """Messages and definitions outside of chunks from here on, up to a limit."""
        data = self._file.read(position, STRETCH)
        found = records_in(data, self.definitions, strict=bool(self.definitions.channels))
        _, end = self._scan.head(position) or (0, position)
        if not found.end and end <= self._file.size:  # the first record alone is longer
            data = self._file.read(position, end - position)
            found = records_in(data, self.definitions)
        end = position + found.end
        if found.end and end < self._file.size and not self._scan.is_plausible(end):
            following = self._scan.next_record(end + 1)
            if not self._scan.begun(end, following, found.span_ns[1]):
                data, found = data[: found.last], Records()  # the length of the last one is wrong
        if found.unknown or not found.end:
            found = self._records(data)
        if not found.end:
            return self._gap(position)
        self._messages_left -= found.count
        end = position + found.end
        return [Piece(end, data, found, _block(position, end, found))], end

    def _records(self, content: bytes) -> Records:
        """The messages of some bytes; for lack of better, definitions may be doubtful."""
        found = records_in(content, self.definitions)
        if found.unknown and (added := self.definitions.complete(self._doubts)):
            self.doubtful |= added
            found = records_in(content, self.definitions)
        self.unknown += found.unknown
        return found

    def _other(self, opcode: int, position: int, end: int) -> tuple[list[Found], int]:
        body = self._scan.body(position, end)
        if opcode == Opcode.METADATA:
            return [parsed(opcode, body)], end
        if opcode == Opcode.ATTACHMENT:
            (checksum,) = struct.unpack("<I", body[-4:])
            with suppress(*PARSE_ERRORS):
                if checksum in (0, zlib.crc32(body[:-4])):
                    return [Attachment.read(ReadDataStream(BytesIO(body)))], end
            return [Loss(position, end, "attachment damaged")], end
        return [], end


def _block(begin: int, end: int, found: Records, head: ChunkHead | None = None) -> Block:
    return Block(found.span_ns[0], begin, end, head, found.count, frozenset(found.index))
