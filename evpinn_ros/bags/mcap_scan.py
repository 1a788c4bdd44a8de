"""The records of an MCAP file that may be damaged anywhere: where one begins, and the summary.

A record is plausible when its content fills its length exactly, and after a search only when what
follows begins a record too.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
import re
import struct
import zlib

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics
from mcap.stream_reader import StreamReader
import numpy as np

from evpinn_ros.bags.limits import LONGEST_CHUNK
from evpinn_ros.bags.mcap_content import (
    CHUNK,
    FOOTER,
    HEAD,
    INDEX_HEAD,
    LENGTH,
    MAGIC,
    MESSAGE_HEAD,
    MESSAGE_SIZE,
    OPCODES,
    PARSE_ERRORS,
    ChunkHead,
    Definitions,
    MessageIndex,
    index_size,
    parsed_from,
)
from evpinn_ros.common.opener import WINDOW, FileBytes
from evpinn_ros.common.units import MEBIBYTE

LONGEST_RECORD = 16 * MEBIBYTE  # of any other kind
NEAR_NS = 86_400_000_000_000  # a day: messages that follow each other are nearer in log time
PRIVATE = 0x80  # opcodes from here on are free for any use
LARGEST_SUMMARY = 64 * MEBIBYTE  # that of 500 000 chunks; with a larger one the file is searched
_SIZES = {Opcode.FOOTER: FOOTER.size, Opcode.SUMMARY_OFFSET: 17, Opcode.DATA_END: 4}
# A record of less than 4 GiB: what to look for behind a damage.
_BEGINNING = re.compile(rb"(?=[\x01-\x0f].{4}\0{4})", re.DOTALL)


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
