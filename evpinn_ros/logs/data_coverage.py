"""Data coverage of a recorded drive: when speed and battery are known, and the car moves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.core.signals.block import KINDS, Block
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading
from evpinn_ros.core.signals.stream import StreamSettings
from evpinn_ros.logs.source import STRAGGLING_NS

MOVING = 1.0  # m/s
SHORTEST = 10.0  # s: shorter spans are not reported
MAX_GAP_NS = int(StreamSettings().max_gap * NANOSECONDS)
# A signal with a period of 5 s is bridged over some steps, but never over a stop.
STEPS_BRIDGED = 6
LONGEST_BRIDGED_NS = 30 * NANOSECONDS
AT_ONCE = 4096  # stamps that are checked together if time goes back

Span: TypeAlias = tuple[int, int]  # first and last stamp, ns
Stamps: TypeAlias = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ReadingFlow:
    """Stamps of one kind of reading, in order of arrival.

    Attributes:
        count: number of readings.
        first_ns: earliest stamp, ns.
        last_ns: latest stamp, ns.
        longest_gap: longest time between two readings, s.
        limit_ns: longest gap that is bridged, some steps of the signal, ns.
        runs: stretches without a longer gap.
    """

    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    longest_gap: float = 0.0
    limit_ns: int = MAX_GAP_NS
    runs: tuple[Span, ...] = ()

    @classmethod
    def of(cls, stamps: Stamps) -> ReadingFlow:
        """The flow of stamps, ns, shape (n,); late readings make no gap."""
        if not len(stamps):
            return cls()
        newest = _newest(stamps)
        steps = stamps - newest[:-1]
        near = steps[(steps > 0) & (steps <= LONGEST_BRIDGED_NS)]
        typical = int(near.sum()) // len(near) if len(near) else 0
        limit_ns = min(max(MAX_GAP_NS, STEPS_BRIDGED * typical), LONGEST_BRIDGED_NS)
        broken = (steps > limit_ns) | (steps < -STRAGGLING_NS)
        begins = [int(stamps[0]), *stamps[broken].tolist()]
        ends = [*newest[:-1][broken].tolist(), int(newest[-1])]
        return cls(
            count=len(stamps),
            first_ns=int(stamps.min()),
            last_ns=int(stamps.max()),
            longest_gap=max(0.0, float(steps.max()) / NANOSECONDS),
            limit_ns=limit_ns,
            runs=tuple(zip(begins, ends, strict=True)),
        )

    @property
    def rate(self) -> float:
        """Readings per second; NaN if no time passed."""
        passed = (self.last_ns - self.first_ns) / NANOSECONDS
        return (self.count - 1) / passed if passed > 0 else math.nan

    @property
    def gaps(self) -> int:
        """Number of gaps that are longer than the estimator bridges."""
        return max(0, len(self.runs) - 1)


def _newest(stamps: Stamps) -> Stamps:
    """Newest stamp before each reading and at the end, shape (n + 1,); a jump back restarts."""
    newest = np.empty(len(stamps) + 1, np.int64)
    newest[0] = newest_ns = int(stamps[0])
    first = 0
    while first < len(stamps):
        part = stamps[first : first + AT_ONCE]
        highest = np.maximum(np.maximum.accumulate(part), newest_ns)
        before = np.append(newest_ns, highest[:-1])
        back = np.flatnonzero(part - before < -STRAGGLING_NS)
        if len(back):
            highest = highest[: back[0] + 1]
            highest[-1] = part[back[0]]
        newest[first + 1 : first + 1 + len(highest)] = highest
        first, newest_ns = first + len(highest), int(highest[-1])
    return newest


@dataclass(frozen=True, slots=True)
class DataCoverage:
    """Data of a drive that the estimator can use."""

    flows: dict[str, ReadingFlow]  # by kind of reading, such as `speed`
    # stretches of speed and battery without a long gap, of `SHORTEST` at least
    spans: tuple[Span, ...]
    moving: float  # s of the spans in which the car moves
    distance: float  # m, of the whole drive, where speed is known
    voltage: float  # mean of the battery, V; NaN without one
    # first and last state of charge, 0..1; NaN if unknown
    charge: tuple[float, float] = (math.nan, math.nan)

    @property
    def seconds(self) -> float:
        """Total length of the spans, s."""
        return _seconds(self.spans)

    @property
    def verdict(self) -> str:
        """Sentence on what can be learned, or why nothing can."""
        for kind in ("speed", "voltage", "current"):
            flow = self.flows.get(kind)
            if flow is None:
                return f"nothing can be learned: no {kind}"
            if not self.spans and flow.longest_gap * NANOSECONDS > flow.limit_ns:
                return (
                    f"nothing can be learned: {kind} comes {flow.rate:.2g} times a second with "
                    f"gaps of up to {flow.longest_gap:.3g} s; only gaps of up to "
                    f"{flow.limit_ns / NANOSECONDS:.3g} s are bridged"
                )
        if not self.spans:
            return f"nothing can be learned: no {SHORTEST:g} s with both speed and battery"
        if self.moving == 0:
            return "little can be learned: the car never moves"
        return f"{self.seconds:.0f} s can be used, {self.moving:.0f} s of them moving"


def data_coverage(blocks: Iterable[Block]) -> DataCoverage:
    """Coverage of the readings of a drive, whose signals may have separate stamps."""
    parts: dict[str, list[tuple[Stamps, np.ndarray]]] = {
        name: [(np.empty(0, np.int64), np.empty(0))] for kind in KINDS for name in _names(kind)
    }
    for block in blocks:
        for kind, (_, stamps, values) in block.rows.items():
            for name, column in zip(_names(kind), values, strict=False):
                finite = np.isfinite(column)
                parts[name].append((stamps[finite], column[finite]))
    columns = {
        name: [*map(np.concatenate, zip(*some, strict=True))] for name, some in parts.items()
    }
    flows = {name: ReadingFlow.of(stamps) for name, (stamps, _) in columns.items()}
    speed, voltage, current = (flows[name].runs for name in ("speed", "voltage", "current"))
    both = _common(speed, _common(voltage, current))
    spans = tuple(span for span in both if _seconds([span]) >= SHORTEST)
    stamps, speeds = columns["speed"]
    steps, mean = np.diff(stamps), 0.5 * np.abs(speeds[1:] + speeds[:-1])
    joined = (steps > 0) & (steps <= flows["speed"].limit_ns)
    moving = ReadingFlow.of(stamps[np.abs(speeds) > MOVING])
    volts, charge = columns["voltage"][1], columns["charge"][1]
    return DataCoverage(
        flows={name: flow for name, flow in flows.items() if flow.count},
        spans=spans,
        moving=_seconds(_common(spans, moving.runs)),
        distance=float(mean[joined] @ steps[joined]) / NANOSECONDS,
        voltage=float(volts.mean()) if len(volts) else math.nan,
        charge=(float(charge[0]), float(charge[-1])) if len(charge) else (math.nan, math.nan),
    )


def _names(kind: type[Reading]) -> tuple[str, ...]:
    """The signals of a kind of reading: its first fields."""
    if kind is BatteryReading:
        return "voltage", "current", "charge"
    return (kind.__name__.removesuffix("Reading").lower(),)


def _common(first: Sequence[Span], second: Sequence[Span]) -> list[Span]:
    """Intersection of two lists of spans, neither with overlaps of its own."""
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
