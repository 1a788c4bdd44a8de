"""One MCAP file, whole or broken, in log time order.

The index of a sound file says where its chunks lie; any other file is gone through as
`evpinn recover` does it (`salvage`), so that both find the same messages. Damaged chunks are left
out, a chunk that is cut gives its whole messages, and `problem` says what was lost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, field
import heapq
import math
from pathlib import Path
from typing import TypeAlias

from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from evpinn_ros.bags.limits import LONGEST_CHUNK, MOST_HELD, most_messages
from evpinn_ros.bags.mcap_content import (
    HEAD,
    INDEX_ENTRY,
    INDEX_HEAD,
    MAGIC,
    MESSAGE_SIZE,
    Block,
    Definitions,
    block_content,
    records_in,
)
from evpinn_ros.bags.mcap_scan import McapScan, summary_of
from evpinn_ros.bags.salvage import Loss, Piece, Salvage
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import FileBytes, most_unpacked

OVERLAP = "chunks overlap too far: not all is in order of time"
OVERHEAD = 250  # bytes of a message in Python beside its data

RawMessage: TypeAlias = tuple[int, int, bytes]  # log time, ns; channel id; data
_Placed: TypeAlias = tuple[int, tuple[int, int], int, bytes]  # the same with its place in the file


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic of a file, the type of its messages, and how they are encoded."""

    topic: str
    type_name: str
    encoding: str


class McapFile:
    """An open MCAP file.

    Attributes:
        channels: by channel id.
        counts: messages by channel id.
    """

    def __init__(self, path: Path) -> None:
        """Find the channels and the messages.

        Raises:
            InputError: not there, empty, or not MCAP.
        """
        self.path = path
        self._file = FileBytes(path)
        try:
            if self._file.size == 0:
                raise InputError(f"{path}: the file is empty")
            if self._file.read(0, len(MAGIC)) != MAGIC:
                raise InputError(f"{path}: not an MCAP file")
            self._found = _sound(self._file) or _salvaged(self._file)
        except InputError:
            self._file.close()
            raise
        self.counts: Mapping[int, int] = self._found.counts
        self.channels: Mapping[int, Channel] = _channels(self._found.definitions)
        self._damaged: set[Block] = set()

    @property
    def problem(self) -> str | None:
        """Damage and losses, in one line. Complete once every message was read."""
        found, parts = self._found, list(self._found.notes)
        if lost_chunks := found.lost_chunks + len(self._damaged):
            lost = sum(block.count for block in self._damaged)
            chunks = found.lost_chunks + sum(block.head is not None for block in found.blocks)
            parts.append(
                f"{lost_chunks} of {chunks} chunks are damaged"
                + (f", {lost} messages lost" if lost else "")
            )
        if not parts:
            return None
        readable = sum(block.count for block in found.blocks if block not in self._damaged)
        return f"{self.path}: {'; '.join(parts)}; {readable} messages are readable"

    def messages(self, wanted: Container[int]) -> Iterator[RawMessage]:
        """The messages of the wanted channel ids in log time order; equal times in file order."""
        blocks = sorted(self._found.blocks, key=lambda block: block.start_ns)
        following = [*(block.start_ns for block in blocks[1:]), math.inf]
        waiting: list[_Placed] = []
        held = 0
        for block, horizon in zip(blocks, following, strict=False):
            for placed in self._messages_of(block, wanted):
                heapq.heappush(waiting, placed)
                held += OVERHEAD + len(placed[-1])
            if held > MOST_HELD:
                horizon = math.inf
                if OVERLAP not in self._found.notes:
                    self._found.notes.append(OVERLAP)
            while waiting and waiting[0][0] < horizon:
                log_time_ns, _, channel, data = heapq.heappop(waiting)
                held -= OVERHEAD + len(data)
                yield log_time_ns, channel, data

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _messages_of(self, block: Block, wanted: Container[int]) -> Iterator[_Placed]:
        if block in self._damaged:
            return
        content = block_content(self._file, block)
        if content is None:
            self._damaged.add(block)
            return
        found = records_in(content, self._found.definitions)
        if block.channels is None and (found.end < len(content) or found.count != block.count):
            self._damaged.add(block)  # not what the index of the file says
            return
        for id_, entries in found.index.items():
            if id_ not in wanted or not (block.channels is None or id_ in block.channels):
                continue
            for log_time_ns, position in entries.tolist():
                (_, length) = HEAD.unpack_from(content, position)
                end = position + HEAD.size + length
                data = content[position + HEAD.size + MESSAGE_SIZE : end]
                yield log_time_ns, (block.begin, position), id_, data


def _salvaged(file: FileBytes) -> _Survey:
    """Messages that going through the file finds."""
    salvage, counts = Salvage(file), Counter[int]()
    blocks: list[Block] = []
    losses: list[Loss] = []
    notes: list[str] = []
    try:
        for each in salvage:
            if isinstance(each, Piece) and each.found.count:
                blocks.append(each.block)
                counts.update({id_: len(entries) for id_, entries in each.found.index.items()})
            elif isinstance(each, Loss) and each.messages != 0:
                losses.append(each)
    except InputError as error:  # a bad sector: what is before it can be read
        notes.append(str(error))
    if losses:
        first = losses[0]
        notes.append(f"cut or damaged at byte {first.begin} of {file.size}: {first.reason}")
    elif not salvage.ended:
        notes.append("the end of the file is missing")
    if salvage.unknown:
        notes.append(f"the topics of {salvage.unknown} messages are lost")
    elif losses and salvage.stated is not None:
        notes.append(f"{max(salvage.stated - counts.total(), 0)} messages lost")
    lost_chunks = sum(loss.chunk for loss in losses)
    return _Survey(salvage.definitions, counts, blocks, notes, lost_chunks)


def _channels(known: Definitions) -> dict[int, Channel]:
    """Channels by id; one whose schema is lost is lost too."""
    # By the specification, schema 0 is that of a channel without one.
    types = {0: ""} | {id_: schema.name for id_, schema in known.schemas.items()}
    return {
        id_: Channel(record.topic, types[record.schema_id], record.message_encoding)
        for id_, record in known.channels.items()
        if record.schema_id in types
    }


@dataclass(slots=True)
class _Survey:
    """Facts of a file that are known before its messages are read."""

    definitions: Definitions  # of schemas and channels
    counts: Counter[int]  # messages by channel id
    blocks: list[Block]  # where the messages lie
    notes: list[str] = field(default_factory=list)  # what is wrong with the file, in words
    lost_chunks: int = 0  # damaged ones that are in no block


def _sound(file: FileBytes) -> _Survey | None:
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
    return _Survey(known, Counter(statistics.channel_message_counts), blocks)


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
