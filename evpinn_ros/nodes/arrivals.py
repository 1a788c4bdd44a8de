"""What the arrival of messages tells: which were lost, and whose stamps leap. Knows no ROS."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

from evpinn_ros.signals.readings import NANOSECONDS

MOST_PUBLISHERS = 16  # of one topic, followed at a time
FUTURE = 2.0  # s
LEAP = (
    10.0  # s by which stamps run ahead from one to the next; bags are replayed ten times as fast
)


class Losses:
    """Messages that a full queue or the network lost, told by the numbers of those that came.

    The middleware drops the oldest of a full queue without a word, but it numbers the messages of
    each publisher. Where it does not tell the numbers (rclpy of Jazzy), nothing is counted.
    """

    def __init__(self) -> None:
        """No message yet."""
        self._numbers: dict[Hashable, dict[bytes, int]] = {}

    def push(self, topic: Hashable, info: Mapping[str, Any]) -> int:
        """Take what rclpy tells of a message; give how many were lost right before it."""
        gid, number = info.get("publisher_gid"), info.get("publication_sequence_number")
        if not gid or not number:
            return 0
        numbers = self._numbers.setdefault(topic, {})
        publisher, number = bytes(gid["data"]), int(number)
        if publisher not in numbers and len(numbers) >= MOST_PUBLISHERS:
            numbers.clear()
        before = numbers.get(publisher, number - 1)
        numbers[publisher] = number
        return max(number - before - 1, 0)


class StampWatch:
    """Stamps of one stream held against the clocks of this computer."""

    def __init__(self) -> None:
        """No stamp yet."""
        self._last: tuple[int, float] | None = None

    def push(self, stamp_ns: int, now_ns: int, steady: float) -> str | None:
        """What is wrong with a stamp, None when nothing is.

        Args:
            stamp_ns: of a message.
            now_ns: of the clock that stamps should be of, 0 while it is not known.
            steady: s of a clock that never jumps.
        """
        last, self._last = self._last, (stamp_ns, steady)
        if now_ns and (stamp_ns - now_ns) / NANOSECONDS > FUTURE:
            return f"stamps are more than {FUTURE:g} s ahead of this computer's clock"
        if last is None:
            return None
        leap = (stamp_ns - last[0]) / NANOSECONDS - (steady - last[1])
        return f"stamps leapt ahead by {leap:.0f} s" if leap > LEAP else None
