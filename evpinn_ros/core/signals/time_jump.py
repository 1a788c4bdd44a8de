"""Distinguish time that jumped back, as when a bag starts over, from stamps that are merely wrong.

Nodes and replays put a `StampGuard` before a stream of samples and react to a `Jump` by their
`JumpPolicy`; behind the guard time does not go back.

Stamps decide, because only they show where in the stream the jump is. The guard holds back a stamp
that leaps until a second one confirms it, so that a single wrong stamp cannot make the estimator
forget a car. A leap that is only a little back needs several in a row, because messages that are
late at random look alike. If the node's own clock went back too, one is enough.

Each source is judged by its own stamps. Sources whose stamps are up to `SKEW_NS` apart share one
time: the one behind is late, as on a busy machine or a slow link. Its items are passed on, and the
receiver uses them at their stamps or drops them as too late.

An abandoned timeline produces no more readings: a bag that starts over does not play its end. If
stamps leap to and fro between two timelines, there are two publishers, and following both would
jump at every turn. So from the first return on, the guard keeps the present timeline, and drops
and counts items of the other until the present one falls silent.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.core.signals.block import Block, joined
from evpinn_ros.core.signals.readings import NANOSECONDS

AGREE_NS = 600 * NANOSECONDS  # two stamps of the leader this close confirm each other
SKEW_NS = 15 * NANOSECONDS  # a source this far behind the others is late, and its clock right
LEFT_NS = 60 * NANOSECONDS  # an abandoned timeline resumes within this
SILENT_NS = 15 * NANOSECONDS  # a publisher that is silent for so long has ended
LATE_IN_A_ROW = 8  # rising stamps a little behind that mean a clock set back, not lateness
USUAL_STEPS = 3  # of the leader, which a stamp may be ahead: phones log at 5 s and slower
MOST_HELD = 1000
LOOKED_AT = 500  # readings whose stamps are judged at once, in a block with a stamp that leaps
MOST_LEFT = 8  # abandoned timelines that are remembered
TAKES_OVER = 20  # stamps of an abandoned timeline in a row that show that the present one ended
SECOND_PUBLISHER = "stamps_of_a_second_publisher"


class JumpPolicy(str, Enum):
    """Reaction to time that jumps back; `ignore` drops late readings.

    `auto` resets if the node's own clock went back too, as /clock does when a bag starts over.
    Otherwise it holds: the drive goes on with what was learned of the car.
    """

    AUTO = "auto"
    RESET = "reset"
    HOLD = "hold"
    IGNORE = "ignore"


class JumpRule(NamedTuple):
    """Reaction to a jump of time; threshold: s by which a stamp may differ without a leap."""

    policy: JumpPolicy = JumpPolicy.AUTO
    threshold: float = 2.0


DEFAULT_RULE = JumpRule()


class Jump(NamedTuple):
    """Time went back by this many seconds before the next item."""

    seconds: float


class _Held(NamedTuple):
    source: object
    stamp_ns: int
    item: Any


@dataclass(slots=True)
class _Left:
    """An abandoned timeline.

    Attributes:
        newest_ns: its newest stamp.
        ahead: whether it lies ahead of the present timeline.
        seen_ns: newest stamp of the present timeline when this one last had a stamp.
        in_a_row: stamps of its leader since the last one of the present timeline's leader.
    """

    newest_ns: int
    ahead: bool
    seen_ns: int
    in_a_row: int = 0

    def continued_by(self, stamp_ns: int, leap_ns: int) -> bool:
        """True if a stamp that leaps by this much continues this timeline."""
        return (leap_ns > 0) == self.ahead and 0 <= stamp_ns - self.newest_ns <= LEFT_NS


class StampGuard:
    """Passes items on in their order and puts a `Jump` where their stamps start over.

    Attributes:
        jumps: number of `Jump`s so far.
        dropped: items not passed on, by reason: `stamp_leaps`, `stamp_held_too_long`,
            `stamps_of_a_second_publisher`.
    """

    def __init__(self, leader: object) -> None:
        """Let the source `leader`, without which nothing works, decide on leaps back."""
        self.jumps = 0
        self.dropped: Counter[str] = Counter()
        self._leader = leader
        self._newest_ns: int | None = None  # of all sources
        self._source_ns: dict[object, int] = {}  # newest stamp by source
        self._ahead_ns: dict[object, int] = {}  # last stamp of sources that were a little ahead
        self._leader_ns: int | None = None  # its newest stamp since the last leap
        self._steps: deque[int] = deque(maxlen=2)
        self._held: list[_Held] = []
        self._left: list[_Left] = []
        self._came_back = False  # to an abandoned timeline
        self._clock_went_back = False

    def clock_went_back(self) -> None:
        """The node's clock jumped back: the next leap back needs no second reading."""
        self._clock_went_back = True
        self._left.clear()

    @property
    def held(self) -> int:
        """Items held back in doubt."""
        return len(self._held)

    def follow(self, block: Block, rule: JumpRule = DEFAULT_RULE) -> Iterator[Block | Jump]:
        """`admit` for a block whose kinds are the sources; whole parts where no stamp leaps."""
        threshold_ns = round(rule.threshold * NANOSECONDS)
        if len(block) and self._goes_on(block, threshold_ns):
            yield block
            return
        passed: list[Block] = []
        for part in block.parts(LOOKED_AT):
            if self._goes_on(part, threshold_ns):
                passed.append(part)
                continue
            for reading in part.readings():
                for item in self.admit(type(reading), reading.stamp_ns, reading, rule):
                    if isinstance(item, Jump):
                        if passed:
                            yield joined(passed)
                        passed = []
                        yield item
                    else:
                        passed.append(Block.of([item]))
        if passed:
            yield joined(passed)

    def _goes_on(self, block: Block, threshold_ns: int) -> bool:
        """True if no stamp of a block leaps; then its stamps are the newest."""
        stamps = block.stamps()
        newest_ns = int(stamps[0]) if self._newest_ns is None else self._newest_ns
        newest = np.maximum(np.maximum.accumulate(stamps), newest_ns)
        ahead = stamps - np.append(newest_ns, newest[:-1])
        if ahead.max() > threshold_ns or ahead.min() < -max(SKEW_NS, threshold_ns):
            return False
        for kind, rows in block.rows.items():
            of_kind = np.append(self._source_ns.get(kind, rows.stamps[0]), rows.stamps)
            if (of_kind[1:] - np.maximum.accumulate(of_kind)[:-1]).min() < -threshold_ns:
                return False
        for kind, rows in block.rows.items():
            self._ahead_ns.pop(kind, None)
            newest_ns = int(rows.stamps.max())
            self._source_ns[kind] = max(newest_ns, self._source_ns.get(kind, newest_ns))
            if kind == self._leader:  # whose last two steps count
                for stamp_ns in np.unique(np.maximum.accumulate(rows.stamps))[-3:].tolist():
                    self._go_on(stamp_ns)
        self._newest_ns = int(newest[-1])
        return True

    def admit(
        self, source: object, stamp_ns: int, item: Any, rule: JumpRule = DEFAULT_RULE
    ) -> Iterable[Any | Jump]:
        """Take one item; returns it, nothing while in doubt, or a jump and the held items.

        Args:
            source: that stamped the item.
            stamp_ns: of the item.
            item: to pass on.
            rule: its threshold is against the newest stamp of the source; `ignore` gives no jump.
        """
        threshold_ns = round(rule.threshold * NANOSECONDS)
        leap_ns = self._leap_ns(source, stamp_ns, threshold_ns)
        if leap_ns == 0:
            return (self._passed(source, stamp_ns, item),)
        return self._in_doubt(_Held(source, stamp_ns, item), leap_ns, threshold_ns, rule.policy)

    def _in_doubt(
        self, held: _Held, leap_ns: int, threshold_ns: int, policy: JumpPolicy
    ) -> Iterator[Any | Jump]:
        """`admit` for an item whose stamp leaps."""
        source, stamp_ns, _ = held
        if leap_ns < 0 and policy is JumpPolicy.IGNORE:
            self._drop(1)
        elif self._of_a_second_publisher(source, stamp_ns, leap_ns):
            self.dropped[SECOND_PUBLISHER] += 1
        else:
            confirmed = self._confirmed(source, stamp_ns, leap_ns, threshold_ns)
            ahead = self._is_ahead(source, stamp_ns, leap_ns)
            self._hold(held)
            if confirmed:
                yield from self._leap(stamp_ns, leap_ns)
            elif ahead:
                yield from self._catch_up(stamp_ns, threshold_ns)

    def _leap_ns(self, source: object, stamp_ns: int, threshold_ns: int) -> int:
        """Distance of a stamp from the nearest possible one, ns; 0 if it is possible."""
        if self._newest_ns is None:
            return 0
        ahead_ns = stamp_ns - self._newest_ns
        if ahead_ns > threshold_ns and ahead_ns > self._usual_ns:
            return ahead_ns
        source_ns = self._source_ns.get(source)
        back_ns = 0 if source_ns is None else stamp_ns - source_ns
        if back_ns < -threshold_ns:
            return back_ns
        # The leader may be behind by any time once it has a stamp: the others are early.
        behind_any = source == self._leader and source_ns is not None
        return 0 if behind_any or -ahead_ns <= SKEW_NS or -ahead_ns <= threshold_ns else ahead_ns

    def _passed(self, source: object, stamp_ns: int, item: Any) -> Any:
        """Pass on an item, the newest of its source."""
        self._ahead_ns.pop(source, None)
        if self._newest_ns is None or stamp_ns > self._newest_ns:
            self._newest_ns = stamp_ns
        if source not in self._source_ns or stamp_ns > self._source_ns[source]:
            self._source_ns[source] = stamp_ns
        if source == self._leader:
            self._go_on(stamp_ns)
        return item

    def _is_ahead(self, source: object, stamp_ns: int, leap_ns: int) -> bool:
        """True if a source is a little ahead for a second time in a row: the others are late."""
        if source == self._leader or not 0 < leap_ns <= SKEW_NS:
            return False
        before_ns, self._ahead_ns[source] = self._ahead_ns.get(source), stamp_ns
        return before_ns is not None and 0 <= stamp_ns - before_ns <= SKEW_NS

    def _catch_up(self, stamp_ns: int, threshold_ns: int) -> Iterator[Any]:
        """Pass on held items that are in no doubt once time has reached this stamp."""
        held, self._held, self._newest_ns = self._held, [], stamp_ns
        for entry in held:
            if self._leap_ns(entry.source, entry.stamp_ns, threshold_ns) == 0:
                yield self._passed(entry.source, entry.stamp_ns, entry.item)
            else:
                self._hold(entry)

    def _of_a_second_publisher(self, source: object, stamp_ns: int, leap_ns: int) -> bool:
        """True if a stamp continues an abandoned timeline that is not to be followed again."""
        left = self._continued(stamp_ns, leap_ns)
        if left is None or not self._came_back:
            return False
        left.newest_ns, left.seen_ns = stamp_ns, stamp_ns - leap_ns
        left.in_a_row += source == self._leader
        if left.in_a_row > TAKES_OVER:
            self._left.remove(left)
            return False
        return True

    def _continued(self, stamp_ns: int, leap_ns: int) -> _Left | None:
        """The abandoned timeline that a leaping stamp continues, or None."""
        now_ns = stamp_ns - leap_ns
        self._left = [
            timeline for timeline in self._left if now_ns - timeline.seen_ns <= SILENT_NS
        ]
        self._came_back &= bool(self._left)
        return next((x for x in self._left if x.continued_by(stamp_ns, leap_ns)), None)

    @property
    def _usual_ns(self) -> int:
        """Largest lead of a stamp by the last two steps of the leader."""
        return USUAL_STEPS * min(self._steps, default=0)

    def _confirmed(self, source: object, stamp_ns: int, leap_ns: int, threshold_ns: int) -> bool:
        if leap_ns < 0 and self._clock_went_back:
            return True
        before = [held.stamp_ns for held in self._held if held.source == source]
        if source == self._leader:
            needed = LATE_IN_A_ROW if -SKEW_NS <= leap_ns < 0 else 2
            newest = [*before, stamp_ns][-needed:]
            rising = all(0 <= later - earlier <= AGREE_NS for earlier, later in pairwise(newest))
            return len(newest) == needed and rising
        # A reading of the leader clears held items, so this source went on without it for long.
        lasted_ns = max(
            (stamp_ns - ns for ns in before if 0 <= stamp_ns - ns <= AGREE_NS), default=0
        )
        return leap_ns > 0 and lasted_ns >= max(threshold_ns, 1)

    def _hold(self, held: _Held) -> None:
        self._held.append(held)
        if len(self._held) > MOST_HELD:
            del self._held[0]
            self.dropped["stamp_held_too_long"] += 1

    def _leap(self, stamp_ns: int, leap_ns: int) -> Iterator[Any | Jump]:
        """Begin a new timeline with the held items that belong to it."""
        held, self._held = self._held, []
        kept = [entry for entry in held if abs(entry.stamp_ns - stamp_ns) <= AGREE_NS]
        self._drop(len(held) - len(kept))
        self._clock_went_back = False
        if (again := self._continued(stamp_ns, leap_ns)) is not None:
            self._left.remove(again)
            self._came_back = True
        left_ns, self._newest_ns = stamp_ns - leap_ns, max(entry.stamp_ns for entry in kept)
        self._left = [*self._left[1 - MOST_LEFT :], _Left(left_ns, leap_ns < 0, self._newest_ns)]
        if leap_ns < 0:
            self.jumps += 1
            self._source_ns.clear()
            yield Jump(-leap_ns / NANOSECONDS)
        self._ahead_ns.clear()
        self._leader_ns = None
        for entry in kept:
            newest_ns = self._source_ns.get(entry.source, entry.stamp_ns)
            self._source_ns[entry.source] = max(entry.stamp_ns, newest_ns)
            if entry.source == self._leader:
                self._step_to(entry.stamp_ns)
        yield from (entry.item for entry in kept)

    def _step_to(self, stamp_ns: int) -> None:
        """The leader came to this stamp."""
        if self._leader_ns is not None and stamp_ns > self._leader_ns:
            self._steps.append(stamp_ns - self._leader_ns)
        self._leader_ns = max(stamp_ns, self._leader_ns or stamp_ns)

    def _go_on(self, stamp_ns: int) -> None:
        """The leader goes on as before, so the held items had wrong stamps."""
        self._step_to(stamp_ns)
        self._clock_went_back = False
        for left in self._left:
            left.in_a_row = 0
        if self._held:
            self._drop(len(self._held))
            self._held.clear()

    def _drop(self, count: int) -> None:
        if count:
            self.dropped["stamp_leaps"] += count
