"""Sources of CAN frames beside a bus (`can.bus`): a log, and a topic of another node."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
import threading
import time
from typing import Any

from evpinn_ros.can.bus import MANY_ERRORS, SILENT_AFTER_S, BusCondition, BusStatus
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.topics import FRAME_TYPE, Topic

DEPTH = 1000  # frames, half a second of a busy bus


class LogPlayer:
    """Plays a CAN log as if it were a bus; call `run` in its own thread."""

    def __init__(
        self, path: Path, rate: float, delay: float, on_frame: Callable[[CanFrame], None]
    ) -> None:
        """Open a log to play after `delay` s at `rate` (0: as fast as possible); or InputError.

        `on_frame` is called in the thread of `run`, and must not raise.
        """
        # Imported here: readers of logs take 6 MB, and a car plays none.
        from evpinn_ros.logs.bus_sources import open_can_log

        self._log, self._rate, self._delay = open_can_log(path), rate, delay
        self._on_frame = on_frame
        self._stop = threading.Event()
        self.problem: str | None = None  # why the log was not played to its end, or None
        self.text = f"playing {path}"  # progress, in a few words
        self.newest_ns = 0  # stamp of the newest frame, 0 before the first

    def run(self) -> None:
        """Play until the end or until `stop`."""
        try:
            self._play()
        except InputError as error:
            self.problem = str(error)
        except OverflowError:  # longer than any system can wait
            self.problem = f"{self._log.path}: frame {self._log.count} has an impossible stamp"
        self.problem = self.problem or self._log.problem
        self.text = f"{self._log.path}: ended after {self._log.count} frames"

    def stop(self) -> None:
        """Make `run` return at the next frame."""
        self._stop.set()

    def _play(self) -> None:
        self._stop.wait(self._delay)
        begin_s = time.monotonic()
        first_ns = None
        for frame in self._log.frames():
            first_ns = frame.stamp_ns if first_ns is None else first_ns
            if self._rate:
                due_s = begin_s + (frame.stamp_ns - first_ns) / NANOSECONDS / self._rate
                self._stop.wait(max(due_s - time.monotonic(), 0.0))
            if self._stop.is_set():
                return
            self.newest_ns = max(self.newest_ns, frame.stamp_ns)
            self._on_frame(frame)


def frame_topic(name: str) -> Topic:
    """The topic of CAN frames with this name."""
    return Topic(name, "the car", "frames of the bus", type_name=FRAME_TYPE, depth=DEPTH)


class FrameTopic:
    """Frames that another node publishes, as a source like `BusReader`."""

    def __init__(
        self, name: str, on_frame: Callable[[CanFrame], None], publishers: Callable[[], int]
    ) -> None:
        """Give frames to `on_frame`; `publishers` counts the publishers of the topic `name`."""
        self._name, self._on_frame, self._publishers = name, on_frame, publishers
        self._counters: Counter[str] = Counter()
        self._newest_s: float | None = None
        self._errors = 0  # error frames in a row
        self._stop = threading.Event()

    def take(self, message: Any, now_ns: int, steady_s: float) -> None:
        """Take one can_msgs/Frame; `now_ns` stamps a frame without a stamp."""
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
        self._on_frame(CanFrame.of_ros(message, now_ns))

    def run(self) -> None:
        """Wait until `stop`: the frames need no thread."""
        self._stop.wait()

    def stop(self) -> None:
        """End the wait of `run`."""
        self._stop.set()

    def status(self, steady_s: float) -> BusStatus:
        """State of the bus, as far as the topic shows it."""
        problem = None
        if not self._publishers():
            condition, problem = BusCondition.CLOSED, f"no publisher of {self._name}"
        elif self._newest_s is None or steady_s - self._newest_s > SILENT_AFTER_S:
            condition = BusCondition.SILENT
        else:
            condition = BusCondition.ERRORS if self._errors >= MANY_ERRORS else BusCondition.OPEN
        return BusStatus(condition, problem, dict(self._counters))
