"""Messages and definitions in the bytes of an MCAP chunk, and how the chunk is unpacked.

Nothing that a file states of itself is trusted: sizes have limits, and an index must agree with
what it points to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
import struct
from typing import Any, NamedTuple, TypeAlias
import zlib

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
import numpy as np
import zstandard

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import FileBytes
from evpinn_ros.common.units import MEBIBYTE

MOST_DEFINITIONS = 64 * MEBIBYTE  # all schemas and channels of a file together

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # opcode, bytes that follow
MESSAGE_HEAD = struct.Struct("<BQHIQ")  # the same, channel, sequence, log time
MESSAGE_SIZE = 22  # of a message without data
CHUNK = struct.Struct("<QQQII")  # first and last log time, size, checksum, bytes of next string
LENGTH = struct.Struct("<Q")
FOOTER = struct.Struct("<QQI")  # start of summary, start of its offsets, checksum of summary
INDEX_HEAD, INDEX_ENTRY = 6, 16  # bytes of a message index
PARSE_ERRORS = (McapError, struct.error, ValueError, LookupError)

_PARSED = {
    Opcode.HEADER: mcap_records.Header,
    Opcode.SCHEMA: mcap_records.Schema,
    Opcode.CHANNEL: mcap_records.Channel,
    Opcode.CHUNK_INDEX: mcap_records.ChunkIndex,
    Opcode.ATTACHMENT_INDEX: mcap_records.AttachmentIndex,
    Opcode.STATISTICS: mcap_records.Statistics,
    Opcode.METADATA: mcap_records.Metadata,
    Opcode.METADATA_INDEX: mcap_records.MetadataIndex,
}
_HEADS = np.dtype("u1, <u8, <u2, <u4, <u8")  # as MESSAGE_HEAD
_HEADS.names = ("opcode", "length", "channel", "sequence", "log_time")
OPCODES = frozenset(Opcode)
MessageIndex: TypeAlias = dict[int, np.ndarray]
"""By channel id: log time, ns, and offset of each message, unsigned, shape (n, 2)."""


class ChunkHead(NamedTuple):
    """Head of a chunk; `first` is where its packed records begin."""

    start_ns: int
    end_ns: int
    size: int
    checksum: int
    compression: str
    first: int
    packed: int


@dataclass(frozen=True, slots=True)
class Block:
    """A stretch of a file that holds message records: a chunk, or records outside of any."""

    start_ns: int  # log time of its first message
    begin: int  # first byte of its (packed) records
    end: int  # behind their last byte; the file may end before it
    head: ChunkHead | None  # of the chunk, None for records outside of chunks
    count: int  # of its messages
    # ids of the messages to be read; None for all, which is what the chunk says
    channels: frozenset[int] | None = None


class Definitions:
    """Schemas and channels, by id; the first one of an id holds."""

    def __init__(self) -> None:
        self.schemas: dict[int, Any] = {}
        self.channels: dict[int, Any] = {}
        self._size = 0

    def take(self, opcode: int, body: bytes) -> bool:
        """Note the record of a schema or channel; False when it is none, or there are too many."""
        record = parsed(opcode, body)
        known = self.schemas if opcode == Opcode.SCHEMA else self.channels
        if record is None:
            return False
        if record.id in known:
            return True
        if self._size + len(body) > MOST_DEFINITIONS:
            return False
        known[record.id] = record
        self._size += len(body)
        return True

    def complete(self, others: Definitions) -> set[str]:
        """Take what others know of ids that are not known here; gives the topics of those."""
        before = set(filter(self.knows, self.channels))
        self.schemas = {**others.schemas, **self.schemas}
        self.channels = {**others.channels, **self.channels}
        return {each.topic for id_, each in self.channels.items() if id_ not in before}

    def knows(self, channel_id: int) -> bool:
        """True if topic and type of a channel are known; schema 0 is none, and needs none."""
        channel = self.channels.get(channel_id)
        return channel is not None and (
            channel.schema_id == 0 or channel.schema_id in self.schemas
        )


@dataclass(slots=True)
class Records:
    """Messages and definitions that follow each other in some bytes."""

    index: MessageIndex = field(default_factory=dict)  # of the messages whose topic is known
    unknown: int = 0  # messages whose topic is not
    last: int = 0  # where the last record begins
    end: int = 0  # behind it

    @property
    def count(self) -> int:
        """Messages whose topic is known."""
        return sum(map(len, self.index.values()))

    @property
    def index_size(self) -> int:
        """Bytes of the message index records."""
        each = HEAD.size + INDEX_HEAD
        return sum(each + INDEX_ENTRY * len(entries) for entries in self.index.values())

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time; zeros without a message."""
        if not self.count:
            return 0, 0
        times = [entries[:, 0] for entries in self.index.values()]
        return int(min(map(np.min, times))), int(max(map(np.max, times)))


def parsed(opcode: int, body: bytes) -> Any:
    """The record of `mcap.records` that fills these bytes exactly, or None."""
    return parsed_from(opcode, BytesIO(body), len(body))


def parsed_from(opcode: int, stream: Any, length: int) -> Any:
    """Record of a stream that holds `length` bytes; reads no more of it than it takes."""
    kind = _PARSED.get(Opcode(opcode)) if opcode in OPCODES else None
    with suppress(*PARSE_ERRORS):
        record = kind.read(ReadDataStream(stream)) if kind is not None else None
        return record if stream.tell() == length else None
    return None


def records_in(data: bytes, definitions: Definitions, *, strict: bool = False) -> Records:
    """Go from record to record, as far as messages and definitions reach.

    Definitions in the data are added to those that are known. Where it is `strict`, a message of
    an unknown channel ends it too.
    """
    found = Records()
    index: dict[int, list[int]] = {}
    unpack, size = MESSAGE_HEAD.unpack_from, len(data)
    position = 0
    while position + HEAD.size <= size:
        opcode, length = HEAD.unpack_from(data, position)
        end = position + HEAD.size + length
        if end > size:
            break
        if opcode == Opcode.MESSAGE and length >= MESSAGE_SIZE:
            _, _, channel, _, log_time_ns = unpack(data, position)
            entries = index.get(channel)
            if entries is None and definitions.knows(channel):
                entries = index[channel] = []
            if entries is not None:
                entries.append(log_time_ns)
                entries.append(position)
            elif strict:
                break
            else:
                found.unknown += 1
        elif opcode not in (Opcode.SCHEMA, Opcode.CHANNEL) or not definitions.take(
            opcode, data[position + HEAD.size : end]
        ):
            break
        found.last, position = position, end
    found.end = position
    found.index = {id_: np.array(entries, "<u8").reshape(-1, 2) for id_, entries in index.items()}
    return found


def indexed_records(data: bytes, index: MessageIndex, definitions: Definitions) -> Records | None:
    """Records by the message indexes that follow a chunk; None where these do not say it all.

    A message of 40 bytes takes 1 us to find by going there, this way a twentieth.
    """
    if not index or not all(len(entries) for entries in index.values()):
        return None
    channels = np.concatenate([np.full(len(e), id_, "<u2") for id_, e in index.items()])
    entries = np.concatenate([*index.values()])
    order = np.argsort(entries[:, 1])
    times, offsets, channels = entries[order, 0], entries[order, 1], channels[order]
    if offsets[-1] > max(len(data) - HEAD.size - MESSAGE_SIZE, 0):
        return None
    places = offsets.astype(np.int64)[:, None] + np.arange(MESSAGE_HEAD.size)
    heads = np.frombuffer(data, np.uint8)[places].view(_HEADS)[:, 0]
    ends = offsets + HEAD.size + heads["length"]
    agree = (heads["opcode"] == Opcode.MESSAGE) & (heads["length"] >= MESSAGE_SIZE)
    agree &= (heads["channel"] == channels) & (heads["log_time"] == times)
    if not agree.all() or ends[-1] > len(data) or (ends < offsets).any():
        return None
    begins, stops = np.append(np.uint64(0), ends), np.append(offsets, np.uint64(len(data)))
    if (begins > stops).any():
        return None
    for gap in np.flatnonzero(begins < stops):
        between = data[int(begins[gap]) : int(stops[gap])]  # definitions, and nothing else
        others = records_in(between, definitions)
        if others.end != len(between) or others.count or others.unknown:
            return None
    if not all(map(definitions.knows, index)):
        return None
    return Records(index, last=int(offsets[-1]), end=len(data))


def block_content(file: FileBytes, block: Block) -> bytes | None:
    """The records of a block, of one that the file cuts as far as they go; None when damaged."""
    try:
        data = file.read(block.begin, block.end - block.begin)
    except InputError:  # a bad sector
        return None
    if block.head is None:
        return data
    return beginning(block.head, data) if block.end > file.size else unpacked(block.head, data)


def unpacked(head: ChunkHead, packed: bytes) -> bytes | None:
    """The records of a chunk, None when they are not what was written; never above the limit."""
    content = b"".join(_pieces(head, packed, head.size + 1))
    if len(content) != head.size or (head.checksum and zlib.crc32(content) != head.checksum):
        return None
    return content


def beginning(head: ChunkHead, packed: bytes) -> bytes:
    """Unpacked beginning of a chunk that is cut or damaged, unchecked."""
    return b"".join(_pieces(head, packed, 1 << 16))[: head.size]


def _pieces(head: ChunkHead, packed: bytes, at_once: int) -> Iterator[bytes]:
    """The unpacked bytes, at most one piece more than the chunk says there are."""
    if head.compression == "":
        yield packed
        return
    left = head.size + 1
    read = _zstd(packed) if head.compression == "zstd" else _lz4(packed)
    with suppress(zstandard.ZstdError, RuntimeError, EOFError):
        while left > 0 and (piece := read(min(at_once, left))):
            left -= len(piece)
            yield piece


def _zstd(packed: bytes) -> Callable[[int], bytes]:
    return zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True).read


def _lz4(packed: bytes) -> Callable[[int], bytes]:
    frames, waiting = LZ4FrameDecompressor(), [packed]

    def read(size: int) -> bytes:
        data = waiting.pop() if waiting else b""
        return b"" if frames.eof else bytes(frames.decompress(data, max_length=size))

    return read


def index_size(body: bytes) -> int:
    """Bytes of entries that a message index says it holds; -1 when it is none."""
    (size,) = struct.unpack_from("<I", body, 2)
    return int(size) if size % INDEX_ENTRY == 0 else -1
