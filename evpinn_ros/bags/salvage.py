"""Pieces of a broken MCAP file that are still whole, and the losses between them.

A record is plausible when its content fills its length exactly, and after a search only when what
follows begins a record too. Chunks prove themselves by their checksum. Records of messages that
lie outside of chunks have none: what is inside them cannot be checked.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
import re
import struct
from typing import TypeAlias
import zlib

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, ChunkIndex, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader
import numpy as np

from evpinn_ros.bags.limits import LONGEST_CHUNK, most_messages
from evpinn_ros.bags.mcap_content import (
    CHUNK,
    FOOTER,
    HEAD,
    INDEX_ENTRY,
    INDEX_HEAD,
    LENGTH,
    MAGIC,
    MESSAGE_HEAD,
    MESSAGE_SIZE,
    OPCODES,
    PARSE_ERRORS,
    Block,
    ChunkHead,
    Definitions,
    MessageIndex,
    Records,
    beginning,
    index_size,
    indexed_records,
    parsed,
    parsed_from,
    records_in,
    unpacked,
)
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import RATIO, WINDOW, FileBytes, most_unpacked
from evpinn_ros.common.units import MEBIBYTE

LONGEST_RECORD = 16 * MEBIBYTE  # of any other kind
NEAR_NS = 86_400_000_000_000  # a day: messages that follow each other are nearer in log time
PRIVATE = 0x80  # opcodes from here on are free for any use
_SIZES = {Opcode.FOOTER: FOOTER.size, Opcode.SUMMARY_OFFSET: 17, Opcode.DATA_END: 4}
# A record of less than 4 GiB: what to look for behind a damage.
_BEGINNING = re.compile(rb"(?=[\x01-\x0f].{4}\0{4})", re.DOTALL)
STRETCH = MEBIBYTE  # messages outside of chunks that are handled together
LOOSE = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
PATIENCE = 1024 * MEBIBYTE, 16  # bytes, and times the file, spent on chunks that prove false
LARGEST_SUMMARY = 64 * MEBIBYTE  # that of 500 000 chunks; with a larger one the file is searched


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


class _Body:
    """The content of a record as a stream: most that look like one are none from the start."""

    def __init__(self, file: FileBytes, begin: int, end: int) -> None:
        self._file, self._begin, self._end = file, begin, end
        self._position = begin

    def read(self, length: int) -> bytes:
        data = self._file.read(self._position, min(length, self._end - self._position))
        self._position += len(data)
        return data

    def tell(self) -> int:
        return self._position - self._begin


class McapScan:
    """Finds records in an MCAP file that may be damaged anywhere."""

    def __init__(self, file: FileBytes, definitions: Definitions) -> None:
        """Look at a file; the definitions are those known so far, and are looked at anew."""
        self._file, self._definitions = file, definitions
        self.size = file.size

    def head(self, position: int) -> tuple[int, int] | None:
        """Opcode of the record that may begin here and where it would end; None past the end."""
        data = self._file.read(position, HEAD.size)
        if len(data) < HEAD.size:
            return None
        opcode, length = HEAD.unpack(data)
        return opcode, position + HEAD.size + length

    def body(self, position: int, end: int) -> bytes:
        """The content of a record."""
        begin = position + HEAD.size
        return self._file.read(begin, end - begin)

    def chunk(self, position: int, end: int) -> ChunkHead | None:
        """The head of the chunk that begins here; None when it contradicts itself."""
        data = self._file.read(position + HEAD.size, CHUNK.size + 4 + LENGTH.size)
        if len(data) < CHUNK.size + LENGTH.size:
            return None
        start_ns, end_ns, size, checksum, name_length = CHUNK.unpack_from(data)
        names = {0: (b"",), 3: (b"lz4",), 4: (b"zstd",)}.get(name_length, ())
        name = data[CHUNK.size : CHUNK.size + name_length]
        if name not in names or len(data) < CHUNK.size + name_length + LENGTH.size:
            return None
        (packed,) = LENGTH.unpack_from(data, CHUNK.size + name_length)
        first = position + HEAD.size + CHUNK.size + name_length + LENGTH.size
        if first + packed != end or (not name and size != packed):
            return None
        return ChunkHead(start_ns, end_ns, size, checksum, name.decode(), first, packed)

    def is_plausible(self, position: int) -> bool:
        """True if a plausible record begins here; the file may cut it."""
        head = self.head(position)
        if head is None:
            return False
        opcode, end = head
        length = end - position - HEAD.size
        if opcode == Opcode.CHUNK:
            return self.chunk(position, end) is not None
        if opcode == Opcode.MESSAGE:
            return MESSAGE_SIZE <= length <= LONGEST_CHUNK and self._knows(position)
        if opcode == Opcode.MESSAGE_INDEX:
            data = self._file.read(position + HEAD.size, INDEX_HEAD)
            whole = len(data) == INDEX_HEAD and length == INDEX_HEAD + index_size(data)
            return whole and length <= LONGEST_CHUNK
        if opcode == Opcode.ATTACHMENT:
            return self._is_attachment(position, end)
        if opcode in _SIZES:
            return length == _SIZES[Opcode(opcode)]
        if length > LONGEST_RECORD or end > self.size:
            return False
        if opcode >= PRIVATE:  # of some program's own: to be skipped
            following = self.head(end)
            return following is not None and following[0] in OPCODES
        return (
            parsed_from(opcode, _Body(self._file, position + HEAD.size, end), length) is not None
        )

    def _is_attachment(self, position: int, end: int) -> bool:
        """True if the lengths in the attachment that begins here add up."""
        if end > self.size or end - position > LONGEST_CHUNK:
            return False
        at = position + HEAD.size + 16  # behind two times
        for _ in ("name", "media type"):
            data = self._file.read(at, 4)
            at += 4 + (struct.unpack("<I", data)[0] if len(data) == 4 else self.size)
        data = self._file.read(at, LENGTH.size)
        return len(data) == LENGTH.size and at + LENGTH.size + LENGTH.unpack(data)[0] + 4 == end

    def message_indexes(self, position: int) -> tuple[MessageIndex, int]:
        """Indexes of the messages of a chunk, by channel, and the position behind them.

        Args:
            position: byte behind the chunk, where the first index begins.
        """
        found: MessageIndex = {}
        first = position
        while True:
            opcode, end = self.head(position) or (0, position)
            if (
                opcode != Opcode.MESSAGE_INDEX
                or end > self.size
                or not self.is_plausible(position)
            ):
                return found, position
            if end - first > LONGEST_CHUNK:
                return {}, position
            body = self.body(position, end)
            (channel,) = struct.unpack_from("<H", body)
            if end - position > INDEX_HEAD + HEAD.size:
                found[channel] = np.frombuffer(body, "<u8", offset=INDEX_HEAD).reshape(-1, 2)
            position = end

    def next_record(self, position: int) -> int:
        """Position of the first plausible record from here on; else the end."""
        step = WINDOW // 2
        while position < self.size:
            data = self._file.read(position, step + HEAD.size)
            for match in _BEGINNING.finditer(data):
                if match.start() >= step:
                    break
                if self._certain(position + match.start()):
                    return position + match.start()
            position += step
        return self.size

    def begun(self, position: int, following: int, near_ns: int) -> bool:
        """True if a damaged record seems to begin here and to reach up to the following one.

        If not, the length of the record before was wrong. `near_ns` is a log time before it.
        """
        data = self._file.read(position, MESSAGE_HEAD.size)
        if len(data) < MESSAGE_HEAD.size:
            return True
        opcode, length, channel, _, log_time_ns = MESSAGE_HEAD.unpack(data)
        if position + HEAD.size + length == following:
            return True
        near = abs(log_time_ns - near_ns) < NEAR_NS
        return opcode == Opcode.MESSAGE and near and self._definitions.knows(channel)

    def _knows(self, position: int) -> bool:
        """True where the channel of a message is known; any is plausible where none is."""
        data = self._file.read(position, MESSAGE_HEAD.size)
        if len(data) < MESSAGE_HEAD.size:
            return False
        return not self._definitions.channels or self._definitions.knows(
            MESSAGE_HEAD.unpack(data)[2]
        )

    def _certain(self, position: int) -> bool:
        """True if the record that begins here is plausible without another before it."""
        if not self.is_plausible(position):
            return False
        opcode, end = self.head(position) or (0, 0)
        if opcode == Opcode.CHUNK:
            return True
        if opcode == Opcode.FOOTER:
            return self._file.read(end, len(MAGIC)) == MAGIC
        return end <= self.size and (self.size - end < HEAD.size or self.is_plausible(end))


@dataclass(slots=True)
class FileSummary:
    """Summary at the end of a file; of a damaged one, as far as it can be read."""

    start: int = 0  # where it begins
    ended: bool = False  # the file has its end
    definitions: Definitions = field(default_factory=Definitions)  # of schemas and channels
    statistics: Statistics | None = None  # what the file counted, or None
    chunks: list[ChunkIndex] = field(default_factory=list)  # the index of the chunks


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
