"""Data coverage of a recorded drive: speed and battery together, moving."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
import math
from typing import TypeAlias

from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.core.signals.stream import StreamSettings
from evpinn_ros.logs.source import STRAGGLING_NS

MOVING = 1.0  # m/s
SHORTEST = 10.0  # s, of a span that is worth naming
MAX_GAP_NS = int(StreamSettings().max_gap * NANOSECONDS)
# A signal that comes every 5 s is bridged over some of its own steps, but never over a stop.
STEPS_BRIDGED = 6
LONGEST_BRIDGED_NS = 30 * NANOSECONDS

Span: TypeAlias = tuple[int, int]  # first and last stamp, ns


@dataclass(slots=True)
class ReadingFlow:
    """Stamps of one kind, as they come."""

    count: int = 0  # of them
    first_ns: int = 0  # the earliest
    last_ns: int = 0  # the latest
    longest_gap: float = 0.0  # between two, s
    _breaks: list[Span] = field(default_factory=list)  # longer than `MAX_GAP_NS`, or back in time
    _begin_ns: int = 0
    _newest_ns: int = 0
    _near_ns: int = 0  # the sum of steps that may be bridged at all
    _near: int = 0

    @property
    def rate(self) -> float:
        """Per second; NaN when no time passed."""
        passed = (self.last_ns - self.first_ns) / NANOSECONDS
        return (self.count - 1) / passed if passed > 0 else math.nan

    @property
    def limit_ns(self) -> int:
        """The longest gap that is bridged: some steps of the signal's own."""
        typical = self._near_ns // self._near if self._near else 0
        return min(max(MAX_GAP_NS, STEPS_BRIDGED * typical), LONGEST_BRIDGED_NS)

    @property
    def gaps(self) -> int:
        """Count of those that are longer than the estimator bridges."""
        return sum(self._parts(place) for place in self._breaks)

    def add(self, stamp_ns: int) -> None:
        """Take the next one; a straggler makes no gap."""
        if not self.count:
            self.first_ns = self.last_ns = self._begin_ns = self._newest_ns = stamp_ns
        step = stamp_ns - self._newest_ns
        if step > MAX_GAP_NS or step < -STRAGGLING_NS:
            self._breaks.append((self._newest_ns, stamp_ns))
        if 0 < step <= LONGEST_BRIDGED_NS:
            self._near_ns, self._near = self._near_ns + step, self._near + 1
        self.longest_gap = max(self.longest_gap, step / NANOSECONDS)
        self.count += 1
        self._newest_ns = max(self._newest_ns, stamp_ns) if step >= -STRAGGLING_NS else stamp_ns
        self.first_ns, self.last_ns = min(self.first_ns, stamp_ns), max(self.last_ns, stamp_ns)

    def all_runs(self) -> list[Span]:
        """Stretches without a gap that is not bridged."""
        if not self.count:
            return []
        parts = [place for place in self._breaks if self._parts(place)]
        begins = [self._begin_ns, *(after for _, after in parts)]
        ends = [*(before for before, _ in parts), self._newest_ns]
        return list(zip(begins, ends, strict=True))

    def _parts(self, gap: Span) -> bool:
        before, after = gap
        return after < before or after - before > self.limit_ns


@dataclass(frozen=True, slots=True)
class DataCoverage:
    """Data of a drive that the estimator can use."""

    flows: dict[str, ReadingFlow]  # readings by kind, as `speed`
    # in which speed and battery come without a gap that is too long, `SHORTEST` at least
    spans: tuple[Span, ...]
    moving: float  # seconds of those in which the car moves
    distance: float  # m, of the whole drive, where speed is known
    voltage: float  # mean of the battery, V; NaN without one
    # state of charge at the first and at the last, 0..1; NaN where unknown
    charge: tuple[float, float] = (math.nan, math.nan)

    @property
    def seconds(self) -> float:
        """Length of all spans, s."""
        return _seconds(self.spans)

    @property
    def verdict(self) -> str:
        """In one line, what can be learned, or why nothing can."""
        for kind in ("speed", "voltage", "current"):
            flow = self.flows.get(kind)
            if flow is None:
                return f"nothing can be learned: no {kind}"
            if not self.spans and flow.longest_gap * NANOSECONDS > flow.limit_ns:
                return (
                    f"nothing can be learned: {kind} comes {flow.rate:.2g} times a second with "
                    f"gaps to {flow.longest_gap:.3g} s; {flow.limit_ns / NANOSECONDS:.3g} s at "
                    "most are bridged"
                )
        if not self.spans:
            return f"nothing can be learned: no {SHORTEST:g} s with both speed and battery"
        if self.moving == 0:
            return "little can be learned: the car never moves"
        return f"{self.seconds:.0f} s can be used, {self.moving:.0f} s of them moving"


def data_coverage(readings: Iterable[Reading]) -> DataCoverage:
    """Look through the readings of a drive, in one pass; each signal has stamps of its own."""
    flows: dict[str, ReadingFlow] = {}
    moving = ReadingFlow()
    distance, voltages, volts = 0.0, 0, 0.0
    charge = (math.nan, math.nan)
    before: SpeedReading | None = None
    for reading in readings:
        for kind in _kinds(reading):
            flows.setdefault(kind, ReadingFlow()).add(reading.stamp_ns)
        if isinstance(reading, BatteryReading):
            if math.isfinite(reading.voltage):
                voltages, volts = voltages + 1, volts + reading.voltage
            if math.isfinite(reading.state_of_charge):
                first = charge[0] if math.isfinite(charge[0]) else reading.state_of_charge
                charge = first, reading.state_of_charge
        if isinstance(reading, SpeedReading):
            step = reading.stamp_ns - before.stamp_ns if before is not None else 0
            if before is not None and 0 < step <= flows["speed"].limit_ns:
                mean = 0.5 * abs(reading.speed + before.speed)
                distance += mean * step / NANOSECONDS
            if abs(reading.speed) > MOVING:
                moving.add(reading.stamp_ns)
            before = reading
    empty = ReadingFlow()
    speed, voltage, current = (
        flows.get(kind, empty).all_runs() for kind in ("speed", "voltage", "current")
    )
    both = _common(speed, _common(voltage, current))
    spans = tuple(span for span in both if _seconds([span]) >= SHORTEST)
    return DataCoverage(
        flows=flows,
        spans=spans,
        moving=_seconds(_common(spans, moving.all_runs())),
        distance=distance,
        voltage=volts / voltages if voltages else math.nan,
        charge=charge,
    )


def _kinds(reading: Reading) -> Iterator[str]:
    if not isinstance(reading, BatteryReading):
        yield type(reading).__name__.removesuffix("Reading").lower()
        return
    if math.isfinite(reading.voltage):
        yield "voltage"
    if math.isfinite(reading.current):
        yield "current"
    if math.isfinite(reading.state_of_charge):
        yield "charge"


def _common(first: Sequence[Span], second: Sequence[Span]) -> list[Span]:
    """The stretches that lie in both; each list without overlaps of its own."""
    spans = []
    ours, theirs = sorted(first), sorted(second)
    i = j = 0
    while i < len(ours) and j < len(theirs):
        begin, end = max(ours[i][0], theirs[j][0]), min(ours[i][1], theirs[j][1])
        if begin < end:
            spans.append((begin, end))
        if ours[i][1] < theirs[j][1]:
            i += 1
        else:
            j += 1
    return spans


def _seconds(spans: Iterable[Span]) -> float:
    return sum(end - begin for begin, end in spans) / NANOSECONDS
