"""Records every topic of this package, and the bridge's CAN frames, into a bag."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from evpinn_ros.bags.types import FRAMES_TOPIC, encode_frame
from evpinn_ros.bags.writer import BagWriter, Split
from evpinn_ros.can.frame import RawFrames
from evpinn_ros.nodes.base import GuardedNode
from evpinn_ros.nodes.diagnosis import Status, with_health
from evpinn_ros.nodes.factory import installed
from evpinn_ros.topics import FRAME_TYPE, TOPICS, Topic
from evpinn_ros.topics.messages import Level

FLUSH_PERIOD = 0.25  # s of messages that a kill may lose


class RecorderNode(GuardedNode):
    """Writes each message with its time of arrival; a disk error ends only this node's work."""

    def __init__(
        self,
        folder: Path,
        frames: RawFrames | None = None,
        split: Split | None = None,
        **kwargs: Any,
    ) -> None:
        """Create the bag; `frames` is a buffer that the bridge fills and this node empties.

        Raises:
            InputError: the bag cannot be created.
        """
        super().__init__("recorder", **kwargs)
        self._counts: Counter[str] = Counter()
        self._problem: str | None = None
        self._frames = deque() if frames is None else frames
        self._frames_topic = self.resolve_topic_name(FRAMES_TOPIC)
        self._writer = BagWriter(folder, live=True, split=split)
        for topic in installed(TOPICS):
            self.listen(topic, partial(self._write, topic), raw=True)
        self.every(FLUSH_PERIOD, self._flush)

    def statuses(self) -> list[Status]:
        """The number of recorded messages, or the problem that ended the recording."""
        counts, folder = self._counts, self._writer.folder
        text = f"{counts['messages']} messages and {counts['frames']} CAN frames in {folder}"
        level = Level.OK if self._problem is None else Level.ERROR
        status = Status("bag", level, self._problem or text, dict(counts))
        return [with_health(status, self.health())]

    def close(self) -> str | None:
        """Complete the bag."""
        self._unless_ended(self._write_frames, self._writer.close)
        return self._problem

    def _flush(self) -> None:
        self._unless_ended(self._write_frames, self._writer.flush)

    def _unless_ended(self, *steps: Callable[[], None]) -> None:
        try:
            if self._problem is None:
                for step in steps:
                    step()
        except OSError as error:
            self._problem = f"recording ended: {self._writer.folder}: {error.strerror}"
            self.get_logger().error(self._problem)
        if self._problem is not None:
            self._frames.clear()  # the bridge still fills it

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
        arrived_ns = self.now_ns()
        self._unless_ended(lambda: self._writer.write_raw(name, topic.type_name, data, arrived_ns))
        self._counts["messages"] += self._problem is None
