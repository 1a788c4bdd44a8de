"""Recorded buses: CAN logs, and bags with topics of raw frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

from evpinn_ros.bags.can_frames import read_frame
from evpinn_ros.bags.metadata import stated_seconds
from evpinn_ros.bags.names import is_bag
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import FRAME_TYPE
from evpinn_ros.can.frame import CanFrame, FirstBus
from evpinn_ros.can.logs import LogFile
from evpinn_ros.common.errors import InputError

_SENT = "to_can_bus"  # the topic by which ros2_socketcan sends frames


class BagFrames:
    """The frames of the `can_msgs/Frame` topics of a bag.

    Of several topics each id is read from one, see `FirstBus`. Stamps are those of the messages'
    headers, or the log time where a header has none.

    Attributes:
        path: of the file or folder.
        count: frames read so far.
        skipped: what is not a data frame, by kind; complete once all are read.
    """

    def __init__(self, path: Path) -> None:
        """Find the topics.

        Raises:
            InputError: not a bag, or no frames in it.
        """
        self.path = path
        self.count = 0
        self.skipped: Counter[str] = Counter()
        self._reader = BagReader(path)
        self._topics = _frame_topics(self._reader)
        if not self._topics:
            raise InputError(f"{path}: no CAN frames ({FRAME_TYPE}) in this bag")

    @property
    def seconds(self) -> float | None:
        """Length that the bag's metadata states, s."""
        return stated_seconds(self.path)

    @property
    def problem(self) -> str | None:
        """Losses of the bag, in one line."""
        return self._reader.problem

    def frames(self) -> Iterator[CanFrame]:
        """Every data frame in order of log time.

        Raises:
            InputError: there is none.
        """
        first_bus = FirstBus()
        with self._reader:
            for record in self._reader.records(self._topics):
                message = record.message
                if message.is_error or message.is_rtr:
                    self.skipped["error_frame" if message.is_error else "remote_frame"] += 1
                    continue
                if not first_bus.takes(message.id, message.is_extended, record.topic):
                    self.skipped["other_bus"] += 1
                    continue
                self.count += 1
                yield read_frame(message, record.log_time_ns)
        self.skipped.update(self._reader.dropped)
        if self.count == 0:
            raise InputError(self.problem or f"{self.path}: no CAN data frame in it")


CanLog: TypeAlias = LogFile | BagFrames
"""A recorded bus, read once by `frames()`."""


def open_can_log(path: Path) -> CanLog:
    """A CAN log of any kind: a file of frames, or a bag with a topic of them.

    Raises:
        InputError: it is neither; the text has the file and the reason.
    """
    return BagFrames(path) if is_bag(path) else LogFile(path)


def holds_frames(path: Path) -> bool:
    """True if a bag has raw frames.

    Raises:
        InputError: it is no bag.
    """
    with BagReader(path) as reader:
        return bool(_frame_topics(reader))


def _frame_topics(reader: BagReader) -> list[str]:
    """Topics with received frames."""
    return [
        name
        for name, info in reader.topics.items()
        if info.type_name == FRAME_TYPE and not name.endswith(_SENT)
    ]
