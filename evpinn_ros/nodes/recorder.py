"""Records every topic of this package into a bag, as the bytes that came over the wire.

The raw frames of a bridge in the same process go beside them, as `can_msgs/Frame`.
"""

from __future__ import annotations

from collections import Counter, deque
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

from evpinn_ros.bags.can_frames import FRAMES_TOPIC, encode_frame
from evpinn_ros.bags.types import FRAME_TYPE
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.nodes.base import GuardedNode
from evpinn_ros.nodes.diagnosis import Status, recorder_status
from evpinn_ros.nodes.topics import TOPICS, Topic

FLUSH_PERIOD = 0.5  # s; a kill may cost this and the time of writing, less than a second

RawFrames: TypeAlias = deque[tuple[int, CanFrame]]
"""Frames on their way from the bridge's thread to the recorder's, with their arrival, ns."""


class RecorderNode(GuardedNode):
    """Writes each message at the time of its arrival, by the node's clock."""

    def __init__(self, folder: Path, frames: RawFrames | None = None, **kwargs: Any) -> None:
        """Begin the bag.

        Args:
            folder: of the bag.
            frames: filled by a bridge, emptied here.
            kwargs: go to rclpy's Node.

        Raises:
            InputError: the folder is in use, or cannot be made.
        """
        super().__init__("recorder", **kwargs)
        self._counts: Counter[str] = Counter()
        self._frames = deque() if frames is None else frames
        self._frames_topic = self.resolve_topic_name(FRAMES_TOPIC)
        self._writer = BagWriter(folder, live=True)
        for topic in TOPICS:
            self.listen(topic, partial(self._write, topic), raw=True)
        self.every(FLUSH_PERIOD, self._flush)

    def statuses(self) -> list[Status]:
        """How much is in the bag."""
        return [recorder_status(str(self._writer.folder), self._counts, self.health())]

    def close(self) -> None:
        """Complete the bag."""
        self._write_frames()
        self._writer.close()

    def _flush(self) -> None:
        self._write_frames()
        self._writer.flush()

    def _write_frames(self) -> None:
        while self._frames:
            arrived_ns, frame = self._frames.popleft()
            try:
                data = encode_frame(frame)
            except ValueError:
                self._counts["frames_left_out"] += 1  # CAN FD
                continue
            self._writer.write_raw(self._frames_topic, FRAME_TYPE, data, arrived_ns)
            self._counts["frames"] += 1

    def _write(self, topic: Topic, data: bytes) -> None:
        name = self.resolve_topic_name(topic.name)
        self._writer.write_raw(name, topic.type_name, data, self.now_ns())
        self._counts["messages"] += 1
