"""Plays a CAN log as if it were a bus: the frames with their own stamps, at a given rate."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import threading
import time

from evpinn_ros.can.frame import CanFrame
from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.can_logs import open_can_log
from evpinn_ros.signals.readings import NANOSECONDS


class LogPlayer:
    """Plays one log; `run` is for a thread of its own, all else for any other.

    Attributes:
        problem: why the log could not be played to its end, None if all is well.
        text: how far it is, in a few words.
        newest_ns: stamp of the newest frame, 0 before the first.
    """

    def __init__(
        self, path: Path, rate: float, delay: float, on_frame: Callable[[CanFrame], None]
    ) -> None:
        """Find the log.

        Args:
            path: of the log, or of a bag with raw frames.
            rate: of real time, 0 for as fast as possible.
            delay: s to wait before the first frame.
            on_frame: called in the thread of `run`; must not raise.

        Raises:
            InputError: no such file, or no CAN log.
        """
        self._log, self._rate, self._delay = open_can_log(path), rate, delay
        self._on_frame = on_frame
        self._stop = threading.Event()
        self.problem: str | None = None
        self.text = f"playing {path}"
        self.newest_ns = 0

    def run(self) -> None:
        """Play until the end or until `stop`."""
        try:
            self._play()
        except InputError as error:
            self.problem = str(error)
        except OverflowError:  # no system waits so long
            self.problem = f"{self._log.path}: a stamp beyond all time, frame {self._log.count}"
        self.problem = self.problem or self._log.problem
        self.text = f"{self._log.path}: at its end after {self._log.count} frames"

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
