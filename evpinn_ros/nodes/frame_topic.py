"""Frames of a CAN bus that another node reads: a topic of `can_msgs/Frame`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import threading
from typing import Any

from evpinn_ros.bags.can_frames import read_frame
from evpinn_ros.bags.types import FRAME_TYPE
from evpinn_ros.can.bus import MANY_ERRORS, SILENT_AFTER_S, BusState, BusStatus
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.topics import Topic

DEPTH = 1000  # frames, half a second of a busy bus


def frame_topic(name: str) -> Topic:
    """The topic of this name."""
    return Topic(name, "the car", "frames of the bus", type_name=FRAME_TYPE, depth=DEPTH)


class FrameTopic:
    """A source of frames as `BusReader` is; what another node receives is given to `take`."""

    def __init__(
        self, name: str, on_frame: Callable[[CanFrame], None], publishers: Callable[[], int]
    ) -> None:
        """Begin before the first frame.

        Args:
            name: of the topic, for people.
            on_frame: called by `take`.
            publishers: counts those of the topic.
        """
        self._name, self._on_frame, self._publishers = name, on_frame, publishers
        self._counters: Counter[str] = Counter()
        self._newest_s: float | None = None
        self._errors = 0  # error frames in a row
        self._stop = threading.Event()

    def take(self, message: Any, now_ns: int, steady_s: float) -> None:
        """One can_msgs/Frame; `now_ns` stamps a frame that has no stamp."""
        self._newest_s = steady_s
        if message.is_error:
            self._counters["error_frames"] += 1
            self._errors += 1
            return
        self._errors = 0
        if message.is_rtr:
            self._counters["remote_frames"] += 1
            return
        self._counters["frames"] += 1
        self._on_frame(read_frame(message, now_ns))

    def run(self) -> None:
        """Wait until `stop`: the frames come without a thread."""
        self._stop.wait()

    def stop(self) -> None:
        """Make `run` return."""
        self._stop.set()

    def status(self, steady_s: float) -> BusStatus:
        """State of the bus, as far as the topic shows it."""
        problem = None
        if not self._publishers():
            state, problem = BusState.CLOSED, f"no publisher of {self._name}"
        elif self._newest_s is None or steady_s - self._newest_s > SILENT_AFTER_S:
            state = BusState.SILENT
        else:
            state = BusState.ERRORS if self._errors >= MANY_ERRORS else BusState.OPEN
        return BusStatus(state, problem, dict(self._counters))
