"""Faults of arriving messages: lost ones, and leaping stamps. Knows no ROS."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Mapping
import math
from typing import Any, NamedTuple

from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes.diagnosis import LATELY

MOST_PUBLISHERS = 16  # of one topic, followed at a time
FUTURE = 0.5  # s
# s by which stamps run ahead from one to the next; bags are replayed ten times as fast
LEAP = 10.0


class NumberCheck(NamedTuple):
    """Loss that the number of a message shows."""

    lost: int  # messages of its publisher, right before it
    by_turns: bool  # another publisher of the topic may speak in between


THE_NEXT = NumberCheck(0, by_turns=False)


class MessageNumbers:
    """Counts lost messages, and finds a second publisher, by the numbers of messages.

    Numbers fall back once when a publisher restarts, and again and again when there are two. (A
    killed publisher is counted by DDS for 20 s.) Jazzy's rclpy does not say whose a message is, so
    nothing counts as lost for `LATELY` after numbers fell back.
    """

    def __init__(self) -> None:
        self._numbers: dict[Hashable, dict[bytes, int]] = defaultdict(dict)
        self._newest: dict[Hashable, int] = defaultdict(int)
        self._fell: dict[Hashable, float] = {}

    def record(self, topic: Hashable, info: Mapping[str, Any], steady: float) -> NumberCheck:
        """Take rclpy's `info` of a message, at a time of the monotonic clock, s."""
        number, gid = info.get("publication_sequence_number"), info.get("publisher_gid")
        if not number:
            return NumberCheck(0, by_turns=True)
        newest, numbers = self._newest[topic], self._numbers[topic]
        self._newest[topic] = number
        publisher = bytes(gid["data"]) if gid else b""
        if number == newest + 1 and publisher in numbers and numbers[publisher] == newest:
            numbers[publisher] = number
            return THE_NEXT
        if publisher not in numbers and len(numbers) >= MOST_PUBLISHERS:
            numbers.clear()
        before = numbers.get(publisher, number - 1)
        numbers[publisher] = number
        fell_lately = steady - self._fell.get(topic, -math.inf) < LATELY
        falls = number <= newest
        if falls:
            self._fell[topic] = steady
        lost = max(number - before - 1, 0) if gid or not fell_lately else 0
        return NumberCheck(lost, falls and fell_lately)


class StampWatch:
    """Check of one stream's stamps against the clocks of this computer."""

    def __init__(self) -> None:
        self._last: tuple[int, float] | None = None

    def check(self, stamp_ns: int, now_ns: int, steady: float) -> str | None:
        """Fault of a stamp or None; `now_ns` of its clock is 0 while unknown, `steady` is s."""
        last, self._last = self._last, (stamp_ns, steady)
        if now_ns and (stamp_ns - now_ns) / NANOSECONDS > FUTURE:
            return f"stamps are more than {FUTURE:g} s ahead of this computer's clock"
        if last is None:
            return None
        leap = (stamp_ns - last[0]) / NANOSECONDS - (steady - last[1])
        return f"stamps leapt ahead by {leap:.0f} s" if leap > LEAP else None
