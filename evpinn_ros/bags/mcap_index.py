"""Where the messages of an MCAP file lie: from its summary, or from a search through the file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from itertools import pairwise
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import ChunkIndex, Schema, Statistics

from evpinn_ros.bags.mcap_records import (
    MAGIC,
    MESSAGE,
    PARSE_ERRORS,
    Block,
    Bytes,
    DamagedError,
    chunk_at,
    has_end,
    records,
    summary_records,
    unpacked,
)

INDEX_HEAD, INDEX_ENTRY = 15, 16  # bytes of a message index record
LONGEST_STRETCH = 16 << 20  # bytes of a file without chunks that are read at once


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic of a file, how its messages are encoded, and the definition of their type."""

    topic: str
    type_name: str
    encoding: str
    schema_encoding: str = ""
    schema: bytes = b""


@dataclass(frozen=True, slots=True)
class McapIndex:
    """What an MCAP file holds.

    Attributes:
        channels: by channel id.
        counts: messages by channel id; after a search, those that can be read.
        blocks: where the messages lie, and how many each holds; 0 where that is not known.
        damaged: those of the blocks that can not be read.
        notes: what else is wrong with the file.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    blocks: dict[Block, int] = field(default_factory=dict)
    damaged: set[Block] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)


def index_of(data: Bytes) -> McapIndex:
    """The index of an MCAP file in bytes that begin with `MAGIC`."""
    return _from_summary(data) or _from_search(data)


def _from_summary(data: Bytes) -> McapIndex | None:
    """The index that the file brings along; None when it has none, or a partial one."""
    summary = summary_records(data)
    statistics = next((record for record in summary if isinstance(record, Statistics)), None)
    chunks = [record for record in summary if isinstance(record, ChunkIndex)]
    channels = _channels(summary)
    if statistics is None or len(channels) != statistics.channel_count:
        return None
    index = McapIndex(channels, Counter(statistics.channel_message_counts))
    for chunk in chunks:
        heads = INDEX_HEAD * len(chunk.message_index_offsets)
        try:
            block = chunk_at(data, chunk.chunk_start_offset)
            block = replace(block, start_ns=chunk.message_start_time)  # guarded by a checksum
        except DamagedError:
            block = Block(chunk.message_start_time, chunk.chunk_start_offset, 0)
            index.damaged.add(block)
        index.blocks[block] = (chunk.message_index_length - heads) // INDEX_ENTRY
    if sum(index.blocks.values()) != statistics.message_count or _overlap(index.blocks):
        return None
    return index


def _overlap(blocks: Iterable[Block]) -> bool:
    """Whether some bytes of the file would be read more than once."""
    ordered = sorted(blocks, key=lambda block: block.begin)
    return any(one.end > other.begin for one, other in pairwise(ordered))


def _from_search(data: Bytes) -> McapIndex:
    """The index made by going through the file and into every chunk, as far as that goes."""
    index = McapIndex()
    definitions: list[Any] = []
    for block in _blocks(data, index.notes):
        try:
            content = unpacked(data, block)
        except DamagedError:
            index.damaged.add(block)
            index.blocks[block] = 0
            continue
        times = []
        for opcode, begin, end in records(content):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                definitions += _definition(opcode, content[begin:end])
            elif opcode == Opcode.MESSAGE and end - begin >= MESSAGE.size:
                channel, _, log_time_ns, _ = MESSAGE.unpack_from(content, begin)
                index.counts[channel] += 1
                times.append(log_time_ns)
        index.blocks[replace(block, start_ns=min(times, default=0))] = len(times)
    index.channels.update(_channels(definitions))
    if lost := sum(index.counts.pop(id_) for id_ in set(index.counts) - set(index.channels)):
        index.notes.append(f"the topics of {lost} messages are lost")
    return index


def _blocks(data: Bytes, notes: list[str]) -> Iterator[Block]:
    """The chunks of the data section, and the stretches of messages and definitions between."""
    position = len(MAGIC)
    loose: int | None = None
    for opcode, _, end in records(data, position):
        if opcode == Opcode.DATA_END:
            if not has_end(data):
                notes.append("the end of the file is missing, but no message")
            break
        if opcode == Opcode.CHUNK:
            if loose is not None:
                yield Block(0, loose, position)
            loose = None
            try:
                yield chunk_at(data, position)
            except DamagedError as error:
                notes.append(f"{error} at byte {position}")
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE) and loose is None:
            loose = position
        if loose is not None and end - loose > LONGEST_STRETCH:
            yield Block(0, loose, end)
            loose = None
        position = end
    else:
        notes.append(f"cut or damaged at byte {position} of {len(data)}")
        with suppress(DamagedError):  # the note says it all
            yield chunk_at(data, position)
    if loose is not None:
        yield Block(0, loose, position)


def _definition(opcode: int, body: bytes) -> Iterator[Any]:
    """The schema or channel record, or nothing when it is damaged: its messages are counted."""
    kind = Schema if opcode == Opcode.SCHEMA else ChannelRecord
    try:
        yield kind.read(ReadDataStream(BytesIO(body)))
    except PARSE_ERRORS:
        return


def _channels(definitions: list[Any]) -> dict[int, Channel]:
    """Channels by id; one whose schema is lost is lost too."""
    schemas = {record.id: record for record in definitions if isinstance(record, Schema)}
    # By the specification, schema 0 is that of a channel without one.
    schemas.setdefault(0, Schema(id=0, name="", encoding="", data=b""))
    return {
        record.id: Channel(
            record.topic,
            schemas[record.schema_id].name,
            record.message_encoding,
            schemas[record.schema_id].encoding,
            schemas[record.schema_id].data,
        )
        for record in definitions
        if isinstance(record, ChannelRecord) and record.schema_id in schemas
    }
