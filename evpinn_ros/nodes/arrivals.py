"""Detects lost messages and leaping stamps, without ROS."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Mapping
import math
from typing import Any, NamedTuple

from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes.diagnosis import LATELY

MOST_PUBLISHERS = 16  # of a topic, tracked at the same time
FUTURE = 0.5  # s by which stamps may be ahead of the clock
# s by which stamps may advance more than time between two messages: bags play at up to 10 times
LEAP = 10.0


class NumberCheck(NamedTuple):
    """Result of checking the sequence number of a message."""

    lost: int  # messages of its publisher, right before it
    by_turns: bool  # whether another publisher of the topic sends in turn


IN_SEQUENCE = NumberCheck(0, by_turns=False)


class MessageNumbers:
    """Counts lost messages and detects a second publisher, by sequence numbers.

    Numbers fall once when a publisher restarts, and repeatedly when there are two. (DDS counts a
    killed publisher for 20 s more.) Jazzy's rclpy does not name the publisher of a message, so
    nothing counts as lost for `LATELY` s after numbers fell.
    """

    def __init__(self) -> None:
        self._numbers: dict[Hashable, dict[bytes, int]] = defaultdict(dict)
        self._newest: dict[Hashable, int] = defaultdict(int)
        self._fell: dict[Hashable, float] = {}

    def record(self, topic: Hashable, info: Mapping[str, Any], steady: float) -> NumberCheck:
        """Check rclpy's `info` of a message that arrived at `steady`, s of the monotonic clock."""
        number, gid = info.get("publication_sequence_number"), info.get("publisher_gid")
        if not number:
            return NumberCheck(0, by_turns=True)
        newest, numbers = self._newest[topic], self._numbers[topic]
        self._newest[topic] = number
        publisher = bytes(gid["data"]) if gid else b""
        if number == newest + 1 and publisher in numbers and numbers[publisher] == newest:
            numbers[publisher] = number
            return IN_SEQUENCE
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
    """Checks the stamps of one stream against the clocks of this computer."""

    def __init__(self) -> None:
        self._last: tuple[int, float] | None = None

    def check(self, stamp_ns: int, now_ns: int, steady: float) -> str | None:
        """Fault of a stamp, or None; `now_ns` is 0 while ROS time is unknown, `steady` is s."""
        last, self._last = self._last, (stamp_ns, steady)
        if now_ns and (stamp_ns - now_ns) / NANOSECONDS > FUTURE:
            return f"stamps are more than {FUTURE:g} s ahead of this computer's clock"
        if last is None:
            return None
        leap = (stamp_ns - last[0]) / NANOSECONDS - (steady - last[1])
        return f"stamps jumped ahead by {leap:.0f} s" if leap > LEAP else None
