"""Tells time that jumped back, as when a bag starts over, from stamps that are merely wrong.

Stamps decide, because only they say where in the stream the jump is. One stamp that leaps proves
nothing: it is held back until a second one confirms it, so that a single wrong stamp cannot make
the estimator forget a car. When the node's own clock went back as well, one is enough.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator
from enum import Enum
from typing import Any, NamedTuple

from evpinn_ros.signals.readings import NANOSECONDS

AGREE_NS = 60 * NANOSECONDS  # stamps of one stretch of time lie this close together
MOST_HELD = 1000


class JumpPolicy(str, Enum):
    """What to do when time jumps back."""

    RESET = "reset"
    HOLD = "hold"
    IGNORE = "ignore"


class Jump(NamedTuple):
    """Time went back by this many seconds before the next item."""

    seconds: float


class _Held(NamedTuple):
    source: Hashable
    stamp_ns: int
    item: Any


class StampGuard:
    """Passes items on in their order and puts a `Jump` where their stamps start over.

    Attributes:
        jumps: how many there were.
        dropped: items not passed on, by reason: `stamp_leaps`, `stamp_held_too_long`.
    """

    def __init__(self, leader: Hashable) -> None:
        """Let the source `leader`, without which nothing works, decide on leaps back."""
        self.jumps = 0
        self.dropped: Counter[str] = Counter()
        self._leader = leader
        self._newest_ns: int | None = None
        self._held: list[_Held] = []
        self._clock_went_back = False

    def clock_went_back(self) -> None:
        """The node's clock jumped back: the next leap back needs no second reading."""
        self._clock_went_back = True

    def push(
        self, source: Hashable, stamp_ns: int, item: Any, threshold: float
    ) -> Iterator[Any | Jump]:
        """Take one item; give it, or nothing while in doubt, or a jump and all that was held.

        Args:
            source: who stamped the item.
            stamp_ns: of the item.
            item: what to pass on.
            threshold: s by which a stamp may differ from the newest of all without being a leap.
        """
        newest_ns = stamp_ns if self._newest_ns is None else self._newest_ns
        leap_ns = stamp_ns - newest_ns
        if abs(leap_ns) <= threshold * NANOSECONDS:
            self._newest_ns = max(stamp_ns, newest_ns)
            if source == self._leader:
                self._go_on()
            yield item
        else:
            confirmed = self._confirmed(source, stamp_ns, leap_ns, threshold)
            self._hold(_Held(source, stamp_ns, item))
            if confirmed:
                yield from self._leap(stamp_ns, leap_ns)

    def _confirmed(self, source: Hashable, stamp_ns: int, leap_ns: int, threshold: float) -> bool:
        if leap_ns < 0 and self._clock_went_back:
            return True
        before = [held.stamp_ns for held in self._held if held.source == source]
        if not before:
            return False
        if source == self._leader:
            return 0 <= stamp_ns - before[-1] <= AGREE_NS
        # A leader that speaks clears what is held, so this one has gone on without it for long.
        return leap_ns > 0 and stamp_ns - before[0] >= threshold * NANOSECONDS

    def _hold(self, held: _Held) -> None:
        self._held.append(held)
        if len(self._held) > MOST_HELD:
            del self._held[0]
            self.dropped["stamp_held_too_long"] += 1

    def _leap(self, stamp_ns: int, leap_ns: int) -> Iterator[Any | Jump]:
        """Begin a new stretch of time, with what was held and belongs to it."""
        held, self._held = self._held, []
        kept = [each for each in held if abs(each.stamp_ns - stamp_ns) <= AGREE_NS]
        self._drop(len(held) - len(kept))
        self._clock_went_back = False
        self._newest_ns = max(each.stamp_ns for each in kept)
        if leap_ns < 0:
            self.jumps += 1
            yield Jump(-leap_ns / NANOSECONDS)
        yield from (each.item for each in kept)

    def _go_on(self) -> None:
        """The leader goes on as before, so what was held had a wrong stamp."""
        self._clock_went_back = False
        self._drop(len(self._held))
        self._held.clear()

    def _drop(self, count: int) -> None:
        if count:
            self.dropped["stamp_leaps"] += count
