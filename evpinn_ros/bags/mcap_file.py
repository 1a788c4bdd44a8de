"""One MCAP file, whole or broken, in log time order.

The libraries refuse a file that was cut, and stop at the first damaged chunk. Here damaged chunks
are left out, a chunk that is cut gives its whole messages, and `problem` says what was lost.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Container, Iterator, Mapping
import math
import mmap
from operator import itemgetter
from pathlib import Path
from typing import TypeAlias

from mcap.opcode import Opcode

from evpinn_ros.bags.mcap_index import Channel, index_of
from evpinn_ros.bags.mcap_records import MAGIC, MESSAGE, Block, DamagedError, records, unpacked
from evpinn_ros.errors import InputError

# Messages held back because a chunk that comes later may have earlier ones. Chunks of a recorder
# overlap by seconds; when more is to be held, order is given up rather than the memory.
MOST_HELD = 512 << 20  # bytes
OVERLAP = "chunks overlap too far: not all is in order of time"
OVERHEAD = 250  # bytes of a message in Python beside its data

RawMessage: TypeAlias = tuple[int, int, bytes]  # log time, ns; channel id; data
_Placed: TypeAlias = tuple[int, tuple[int, int], int, bytes]  # the same with its place in the file


class McapFile:
    """An open MCAP file."""

    def __init__(self, path: Path) -> None:
        """Find the channels and the messages.

        Raises:
            InputError: not there, empty, or not MCAP.
        """
        self.path = path
        self._data = _mapped(path)
        self._index = index_of(self._data)

    @property
    def channels(self) -> Mapping[int, Channel]:
        """Channels by id."""
        return self._index.channels

    @property
    def counts(self) -> Mapping[int, int]:
        """Messages by channel id."""
        return self._index.counts

    @property
    def problem(self) -> str | None:
        """What is wrong and lost, in one line. Complete once every message was read."""
        index = self._index
        parts = list(index.notes)
        if index.damaged:
            lost = sum(index.blocks[block] for block in index.damaged)
            parts.append(
                f"{len(index.damaged)} of {len(index.blocks)} chunks are damaged"
                + (f", {lost} messages lost" if lost else "")
            )
        if not parts:
            return None
        readable = sum(n for block, n in index.blocks.items() if block not in index.damaged)
        return f"{self.path}: {'; '.join(parts)}; {readable} messages are readable"

    def messages(self, wanted: Container[int]) -> Iterator[RawMessage]:
        """The messages of the wanted channel ids in log time order; equal times in file order."""
        blocks = sorted(self._index.blocks, key=lambda block: block.start_ns)
        following = [*(block.start_ns for block in blocks[1:]), math.inf]
        waiting: list[_Placed] = []
        for block, horizon in zip(blocks, following, strict=False):
            waiting += self._messages_of(block, wanted)
            waiting.sort()
            ready = bisect_left(waiting, horizon, key=itemgetter(0))
            if sum(OVERHEAD + len(data) for *_, data in waiting) > MOST_HELD:
                ready = len(waiting)
                if OVERLAP not in self._index.notes:
                    self._index.notes.append(OVERLAP)
            for log_time_ns, _, channel, data in waiting[:ready]:
                yield log_time_ns, channel, data
            del waiting[:ready]

    def close(self) -> None:
        """Close the file."""
        self._data.close()

    def _messages_of(self, block: Block, wanted: Container[int]) -> Iterator[_Placed]:
        if block in self._index.damaged:
            return
        try:
            content = unpacked(self._data, block)
        except DamagedError:
            self._index.damaged.add(block)
            return
        for opcode, begin, end in records(content):
            if opcode == Opcode.MESSAGE and end - begin >= MESSAGE.size:
                channel, _, log_time_ns, _ = MESSAGE.unpack_from(content, begin)
                if channel in wanted:
                    place = (block.begin, begin)
                    yield log_time_ns, place, channel, content[begin + MESSAGE.size : end]


def _mapped(path: Path) -> mmap.mmap:
    try:
        with path.open("rb") as file:
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path}: the file is empty") from error
    if data[: len(MAGIC)] != MAGIC:
        data.close()
        raise InputError(f"{path}: not an MCAP file")
    return data
