"""Faults of arriving messages: lost ones, and leaping stamps. Knows no ROS."""

from __future__ import annotations

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


class MessageNumbers:
    """Messages lost, and publishers that speak by turns, found by the numbers of messages.

    The middleware drops the oldest of a full queue without a word, but it numbers the messages of
    each publisher. Those of a topic fall back once when its publisher is started anew, and again
    and again when there are two. Counting publishers does not tell that: one that was killed is
    counted until its lease ends, after 20 s. In Jazzy rclpy does not say whose a message is; then
    nothing is counted as lost for `LATELY` after numbers fell back.
    """

    def __init__(self) -> None:
        self._numbers: dict[Hashable, dict[bytes, int]] = {}
        self._newest: dict[Hashable, int] = {}
        self._fell: dict[Hashable, float] = {}

    def record(self, topic: Hashable, info: Mapping[str, Any], steady: float) -> NumberCheck:
        """Take what rclpy tells of a message, at a time of the monotonic clock, s.

        Where it tells no number nothing is known, and nothing excluded.
        """
        number, gid = info.get("publication_sequence_number"), info.get("publisher_gid")
        if not number:
            return NumberCheck(0, by_turns=True)
        falls = number <= self._newest.get(topic, 0)
        fell_lately = steady - self._fell.get(topic, -math.inf) < LATELY
        self._newest[topic] = number
        if falls:
            self._fell[topic] = steady
        lost = self._lost(topic, bytes(gid["data"]) if gid else b"", number)
        return NumberCheck(lost if gid or not fell_lately else 0, falls and fell_lately)

    def _lost(self, topic: Hashable, publisher: bytes, number: int) -> int:
        numbers = self._numbers.setdefault(topic, {})
        if publisher not in numbers and len(numbers) >= MOST_PUBLISHERS:
            numbers.clear()
        before = numbers.get(publisher, number - 1)
        numbers[publisher] = number
        return max(number - before - 1, 0)


class StampWatch:
    """Check of one stream's stamps against the clocks of this computer."""

    def __init__(self) -> None:
        self._last: tuple[int, float] | None = None

    def check(self, stamp_ns: int, now_ns: int, steady: float) -> str | None:
        """Fault of a stamp at a time of the monotonic clock, s; None when there is none.

        `now_ns` is of the clock that stamps should be of, 0 while it is not known.
        """
        last, self._last = self._last, (stamp_ns, steady)
        if now_ns and (stamp_ns - now_ns) / NANOSECONDS > FUTURE:
            return f"stamps are more than {FUTURE:g} s ahead of this computer's clock"
        if last is None:
            return None
        leap = (stamp_ns - last[0]) / NANOSECONDS - (steady - last[1])
        return f"stamps leapt ahead by {leap:.0f} s" if leap > LEAP else None
