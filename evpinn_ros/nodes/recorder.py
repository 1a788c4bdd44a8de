"""Records every topic of this package into a bag, as the bytes that came over the wire."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.nodes.base import GuardedNode
from evpinn_ros.nodes.diagnosis import Status, recorder_status
from evpinn_ros.nodes.topics import TOPICS, Topic

FLUSH_PERIOD = 1.0  # s that a kill may cost


class RecorderNode(GuardedNode):
    """Writes each message at the time of its arrival, by the node's clock."""

    def __init__(self, folder: Path, **kwargs: Any) -> None:
        """Begin the bag `folder`; `kwargs` go to rclpy's Node.

        Raises:
            InputError: the folder is in use, or cannot be made.
        """
        super().__init__("recorder", **kwargs)
        self._count = 0
        self._writer = BagWriter(folder, live=True)
        for topic in TOPICS:
            self.listen(topic, partial(self._write, topic), raw=True)
        self.every(FLUSH_PERIOD, self._writer.flush)

    def statuses(self) -> list[Status]:
        """How much is in the bag."""
        return [recorder_status(str(self._writer.folder), self._count, self.health())]

    def close(self) -> None:
        """Complete the bag."""
        self._writer.close()

    def _write(self, topic: Topic, data: bytes) -> None:
        name = self.resolve_topic_name(topic.name)
        self._writer.write_raw(name, topic.type_name, data, self.now_ns())
        self._count += 1
