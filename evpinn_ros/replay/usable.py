"""Which part of a recorded drive the estimator can use: speed and battery together, moving."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
import math
from typing import TypeAlias

from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.signals.stream import StreamSettings

MOVING = 1.0  # m/s
SHORTEST = 10.0  # s, of a span that is worth naming
STRAGGLING_NS = 10 * NANOSECONDS  # stamps that go back further are no stragglers: time began anew
MAX_GAP_NS = int(StreamSettings().max_gap * NANOSECONDS)

Span: TypeAlias = tuple[int, int]  # first and last stamp, ns


@dataclass(slots=True)
class Flow:
    """Stamps of one kind, as they come.

    Attributes:
        count: of them.
        first_ns: the earliest.
        last_ns: the latest.
        longest_gap: between two, s.
        gaps: longer than the estimator bridges.
        runs: stretches without such a gap.
    """

    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    longest_gap: float = 0.0
    gaps: int = 0
    runs: list[Span] = field(default_factory=list)
    _begin_ns: int = 0
    _newest_ns: int = 0

    @property
    def rate(self) -> float:
        """Per second; NaN when no time passed."""
        passed = (self.last_ns - self.first_ns) / NANOSECONDS
        return (self.count - 1) / passed if passed > 0 else math.nan

    def add(self, stamp_ns: int) -> None:
        """Take the next one; a straggler makes no gap."""
        if not self.count:
            self.first_ns = self.last_ns = self._begin_ns = self._newest_ns = stamp_ns
        step = stamp_ns - self._newest_ns
        if step > MAX_GAP_NS or step < -STRAGGLING_NS:
            self.runs.append((self._begin_ns, self._newest_ns))
            self._begin_ns = self._newest_ns = stamp_ns
            self.gaps += 1
        self.longest_gap = max(self.longest_gap, step / NANOSECONDS)
        self.count += 1
        self._newest_ns = max(self._newest_ns, stamp_ns)
        self.first_ns, self.last_ns = min(self.first_ns, stamp_ns), max(self.last_ns, stamp_ns)

    def all_runs(self) -> list[Span]:
        """Those that are over, and the one that goes on."""
        return [*self.runs, (self._begin_ns, self._newest_ns)] if self.count else []


@dataclass(frozen=True, slots=True)
class Usable:
    """What a drive offers the estimator.

    Attributes:
        flows: readings by kind, as `speed`.
        spans: in which speed and battery come without a gap that is too long, `SHORTEST` at least.
        moving: seconds of those in which the car moves.
        distance: m, of the whole drive, where speed is known.
        voltage: mean of the battery, V; NaN without one.
    """

    flows: dict[str, Flow]
    spans: tuple[Span, ...]
    moving: float
    distance: float
    voltage: float

    @property
    def seconds(self) -> float:
        """Of all spans."""
        return _seconds(self.spans)

    @property
    def verdict(self) -> str:
        """In one line, what can be learned, or why nothing can."""
        for kind in ("speed", "battery"):
            flow = self.flows.get(kind)
            if flow is None:
                return f"nothing can be learned: no {kind}"
            if not self.spans and flow.longest_gap * NANOSECONDS > MAX_GAP_NS:
                limit = MAX_GAP_NS / NANOSECONDS
                return (
                    f"nothing can be learned: {kind} comes {flow.rate:.2g} times a second with "
                    f"gaps to {flow.longest_gap:.3g} s; {limit:g} s at most are bridged"
                )
        if not self.spans:
            return f"nothing can be learned: no {SHORTEST:g} s with both speed and battery"
        if self.moving == 0:
            return "little can be learned: the car never moves"
        return f"{self.seconds:.0f} s can be used, {self.moving:.0f} s of them moving"


def usable(readings: Iterable[Reading]) -> Usable:
    """Look through the readings of a drive, in one pass."""
    flows: dict[str, Flow] = {}
    moving = Flow()
    distance, voltages, volts = 0.0, 0, 0.0
    before: SpeedReading | None = None
    for reading in readings:
        kind = type(reading).__name__.removesuffix("Reading").lower()
        if isinstance(reading, BatteryReading):
            if not math.isfinite(reading.power):
                continue
            voltages, volts = voltages + 1, volts + reading.voltage
        flows.setdefault(kind, Flow()).add(reading.stamp_ns)
        if isinstance(reading, SpeedReading):
            step = reading.stamp_ns - before.stamp_ns if before is not None else 0
            if 0 < step <= MAX_GAP_NS:
                distance += abs(reading.speed) * step / NANOSECONDS
            if abs(reading.speed) > MOVING:
                moving.add(reading.stamp_ns)
            before = reading
    empty = Flow()
    both = _common(*(flows.get(kind, empty).all_runs() for kind in ("speed", "battery")))
    spans = tuple(span for span in both if _seconds([span]) >= SHORTEST)
    return Usable(
        flows=flows,
        spans=spans,
        moving=_seconds(_common(spans, moving.all_runs())),
        distance=distance,
        voltage=volts / voltages if voltages else math.nan,
    )


def _common(first: Sequence[Span], second: Sequence[Span]) -> list[Span]:
    """The stretches that lie in both; each list without overlaps of its own."""
    found = []
    ours, theirs = sorted(first), sorted(second)
    i = j = 0
    while i < len(ours) and j < len(theirs):
        begin, end = max(ours[i][0], theirs[j][0]), min(ours[i][1], theirs[j][1])
        if begin < end:
            found.append((begin, end))
        if ours[i][1] < theirs[j][1]:
            i += 1
        else:
            j += 1
    return found


def _seconds(spans: Iterable[Span]) -> float:
    return sum(end - begin for begin, end in spans) / NANOSECONDS
