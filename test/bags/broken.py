"""Bags of every storage, the messages in their parts, and copies that are broken."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
import random
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from evpinn_ros.bags.types import encode, new_message, typestore
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.topics.messages import scalar

START = 1_700_000_000 * NANOSECONDS
STEP = NANOSECONDS // 100
CHUNK_BYTES = 16_000
FLOAT, TEXT = "std_msgs/msg/Float64", "std_msgs/msg/String"
STORAGES = ("zstd", "lz4", "chunks", "loose")
"""Compressed chunks, chunks as they are, and messages outside of chunks."""
FAULTS = ("bit flipped", "cut", "no end")

Identity = tuple[str, int, int, bytes]  # topic, log time, sequence, data


@dataclass(slots=True)
class LostBlock:
    """Bytes of the original that are lost together, and the messages in them."""

    begin: int
    end: int
    messages: list[Identity] = field(default_factory=list)


def write_bag(path: Path, storage: str, size: int, rng: random.Random) -> None:
    """Write an MCAP of at least this many bytes: numbers, and texts of zeros and opcodes."""
    compression = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=CHUNK_BYTES,
            compression=compression.get(storage, CompressionType.NONE),
            use_chunking=storage != "loose",
        )
        writer.start(profile="ros2")
        channels = []
        for name in (FLOAT, TEXT):
            definition, _ = typestore().generate_msgdef(name, ros_version=2)
            schema = writer.register_schema(name, "ros2msg", definition.encode())
            channels += [writer.register_channel(f"/{name[9:]}{i}", "cdr", schema) for i in (1, 2)]
        number = 0
        while file.tell() < size:
            channel = rng.randrange(len(channels))
            text = "".join(rng.choices("\x00\x01\x03\x05\x06\x16", k=rng.randrange(120)))
            message = new_message(TEXT, data=text)
            data = encode(scalar(new_message, rng.random()) if channel < 2 else message)
            moment = START + number * STEP
            writer.add_message(channels[channel], moment, data, moment, number)
            number += 1
        writer.finish()


def messages_of(path: Path) -> list[Identity]:
    """Every message of a sound MCAP file, in the order of the file."""
    with path.open("rb") as file:
        return [
            (channel.topic, message.log_time, message.sequence, message.data)
            for _, channel, message in make_reader(file, validate_crcs=True).iter_messages(
                log_time_order=False
            )
        ]


def chunks_of(path: Path) -> list[Any]:
    """The index of the chunks of a sound file, a `mcap.records.ChunkIndex` each."""
    with path.open("rb") as file:
        return list(make_reader(file).get_summary().chunk_indexes)


def blocks_of(path: Path, loose: bool) -> list[LostBlock]:
    """The chunks of a sound file, or its messages one by one, with what is in each."""
    messages = iter(messages_of(path))
    if not loose:
        blocks = []
        for chunk in chunks_of(path):
            begin, end = chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length
            indexes = len(chunk.message_index_offsets) * 15
            count = (chunk.message_index_length - indexes) // 16
            blocks.append(LostBlock(begin, end, [next(messages) for _ in range(count)]))
        return blocks
    data = path.read_bytes()
    position, blocks = 8, []
    while data[position] != 0x0F:  # data end
        end = position + 9 + int.from_bytes(data[position + 1 : position + 9], "little")
        if data[position] == 0x05:
            blocks.append(LostBlock(position, end, [next(messages)]))
        position = end
    return blocks


def damaged(data: bytes, fault: str, rng: random.Random) -> tuple[bytes, int, int]:
    """A copy of a file with a fault, and the first and the last byte of it that are not sound."""
    if fault == "bit flipped":
        broken = bytearray(data)
        at = rng.randrange(len(data))
        broken[at] ^= 1 << rng.randrange(8)
        return bytes(broken), at, at + 1
    lost = rng.randrange(1, 60) if fault == "no end" else rng.randrange(1, len(data) - 7)
    return data[:-lost], len(data) - lost, len(data)
