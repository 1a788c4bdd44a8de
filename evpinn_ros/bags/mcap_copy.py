"""A new MCAP file of what was saved: whole chunks as they were packed, and single messages."""

from __future__ import annotations

from collections import Counter
import os
from pathlib import Path
import struct
from typing import Any
import zlib

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Statistics,
    SummaryOffset,
)
import numpy as np
import zstandard

from evpinn_ros.bags.mcap_content import (
    CHUNK,
    FOOTER,
    HEAD,
    LENGTH,
    MAGIC,
    ChunkHead,
    Definitions,
    MessageIndex,
    Records,
)
from evpinn_ros.bags.metadata import WrittenFile
from evpinn_ros.bags.writer import LIBRARY
from evpinn_ros.common.errors import as_input_error

INDEX = struct.Struct("<BQHI")  # opcode, bytes that follow, channel, bytes of entries


class McapCopy:
    """A new file, given its content in order.

    Attributes:
        path: of the file.
        counts: messages by channel id.
        written: number and log times of all of them.
    """

    def __init__(self, path: Path) -> None:
        """Make the file; InputError when it is there or cannot be made."""
        self.path = path
        self.counts: Counter[int] = Counter()
        self.written = WrittenFile(path.name)
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._described: set[int] = set()
        self._schemas: set[int] = set()
        with as_input_error(path):
            self._file = path.open("xb")
        self._file.write(MAGIC)
        # Readers that know ROS 2 refuse any other profile; the types are in the schemas.
        self._add(Header(profile="ros2", library=LIBRARY))

    def copy(self, head: ChunkHead, packed: bytes, found: Records, known: Definitions) -> None:
        """Add a chunk as it was packed."""
        self._describe(found.index, known)
        start_ns, end_ns = found.span_ns
        begin = self._file.tell()
        name = head.compression.encode()
        length = CHUNK.size + len(name) + LENGTH.size + len(packed)
        self._file.write(HEAD.pack(Opcode.CHUNK, length))
        self._file.write(CHUNK.pack(start_ns, end_ns, head.size, head.checksum, len(name)))
        self._file.write(name + LENGTH.pack(len(packed)))
        self._file.write(packed)
        indexes = self._file.tell()
        offsets = {id_: self._index(id_, entries) for id_, entries in found.index.items()}
        self._chunks.append(
            ChunkIndex(
                chunk_length=indexes - begin,
                chunk_start_offset=begin,
                compression=head.compression,
                compressed_size=len(packed),
                message_end_time=end_ns,
                message_index_length=self._file.tell() - indexes,
                message_index_offsets=offsets,
                message_start_time=start_ns,
                uncompressed_size=head.size,
            )
        )
        self.written.add(start_ns, end_ns, found.count)
        self.counts.update({id_: len(entries) for id_, entries in found.index.items()})

    def pack(self, content: bytes, found: Records, known: Definitions) -> None:
        """Add messages as a new chunk."""
        if not found.count:
            return
        data, index = content[: found.end], found.index
        if found.unknown:
            data, index = _known_alone(content, index)
        packed = zstandard.compress(data)
        head = ChunkHead(0, 0, len(data), zlib.crc32(data), "zstd", 0, len(packed))
        self.copy(head, packed, Records(index), known)

    def attach(self, record: Attachment) -> None:
        """Add an attachment."""
        place = self._add(record)
        times, size = (record.log_time, record.create_time), len(record.data)
        index = AttachmentIndex(*place, *times, size, record.name, record.media_type)
        self._attachments.append(index)

    def note(self, record: Metadata) -> None:
        """Add metadata."""
        self._metadata.append(MetadataIndex(*self._add(record), record.name))

    def finish(self, known: Definitions) -> None:
        """Write the summary and the end, and close the file."""
        self._add(DataEnd(data_section_crc=0))
        start = self._file.tell()
        channels = [known.channels[id_] for id_ in sorted(self._described)]
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self._chunks),
            message_count=self.written.count,
            message_end_time=self.written.end_ns,
            message_start_time=self.written.start_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: dict[Opcode, list[Any]] = {
            Opcode.SCHEMA: [known.schemas[id_] for id_ in sorted(self._schemas)],
            Opcode.CHANNEL: channels,
            Opcode.STATISTICS: [statistics],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.ATTACHMENT_INDEX: self._attachments,
            Opcode.METADATA_INDEX: self._metadata,
        }
        summary, offsets = RecordBuilder(), RecordBuilder()
        for opcode, records in groups.items():
            begin = summary.count
            for record in records:
                record.write(summary)
            if records:
                length = summary.count - begin
                SummaryOffset(opcode, group_start=start + begin, group_length=length).write(
                    offsets
                )
        data = bytes(summary.end())
        offsets_start = start + len(data)
        data += bytes(offsets.end())
        footer = HEAD.pack(Opcode.FOOTER, FOOTER.size) + struct.pack("<QQ", start, offsets_start)
        self._file.write(data)
        self._add(Footer(start, offsets_start, zlib.crc32(data + footer)))
        self._file.write(MAGIC)
        self._file.flush()
        os.fsync(self._file.fileno())
        self.close()

    def close(self) -> None:
        """Close the file, finished or not; a second call does nothing."""
        self._file.close()

    def _describe(self, index: MessageIndex, known: Definitions) -> None:
        """Write the definitions that these messages need and that are not in the file yet."""
        for id_ in index:
            if id_ in self._described:
                continue
            channel = known.channels[id_]
            if channel.schema_id and channel.schema_id not in self._schemas:
                self._add(known.schemas[channel.schema_id])
                self._schemas.add(channel.schema_id)
            self._add(channel)
            self._described.add(id_)

    def _index(self, channel_id: int, entries: np.ndarray) -> int:
        """Write the message index of a chunk's channel; gives where it begins."""
        begin, data = self._file.tell(), entries.tobytes()
        self._file.write(INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(data), channel_id, len(data)))
        self._file.write(data)
        return begin

    def _add(self, record: Any) -> tuple[int, int]:
        """Write a record; gives where it begins and its length."""
        begin, builder = self._file.tell(), RecordBuilder()
        record.write(builder)
        return begin, self._file.write(builder.end())


def _known_alone(content: bytes, index: MessageIndex) -> tuple[bytes, MessageIndex]:
    """The messages of an index without what lies between them, and the index of those."""
    places = sorted(
        (position, log_time_ns, id_)
        for id_, entries in index.items()
        for log_time_ns, position in entries.tolist()
    )
    parts: list[bytes] = []
    moved: dict[int, list[tuple[int, int]]] = {}
    size = 0
    for position, log_time_ns, id_ in places:
        (_, length) = HEAD.unpack_from(content, position)
        parts.append(content[position : position + HEAD.size + length])
        moved.setdefault(id_, []).append((log_time_ns, size))
        size += len(parts[-1])
    return b"".join(parts), {id_: np.array(each, "<u8") for id_, each in moved.items()}
