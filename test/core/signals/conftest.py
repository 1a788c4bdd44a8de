from collections import Counter
from collections.abc import Callable, Iterable
import math
from typing import NamedTuple, TypeAlias

import numpy as np
import pytest

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.newest import NewestTrack
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading
from evpinn_ros.core.signals.reorder import ReorderBuffer
from evpinn_ros.core.signals.sample import Events, Sample
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings

START = 1_700_000_000 * NANOSECONDS


def stamp_at(seconds: float) -> int:
    """The stamp this many seconds after the start."""
    return START + round(seconds * NANOSECONDS)


@pytest.fixture
def at() -> Callable[[float], int]:
    """The stamp this many seconds after the start."""
    return stamp_at


class Stream:
    """A stream behind its reorder buffer, as the estimator has them."""

    def __init__(self, **settings) -> None:
        """With an air density of 1.2 kg/m^3."""
        chosen = StreamSettings(**settings)
        self.stream, self.buffer = (
            SampleStream(chosen, 1.2),
            ReorderBuffer(chosen.allowed_lateness),
        )
        self.newest = NewestTrack(chosen.max_gap, math.nan)

    @property
    def dropped(self) -> Counter[str]:
        return self.buffer.dropped + self.stream.dropped

    def add(self, readings: Iterable[Reading]) -> Events:
        """What readings complete that come in this order."""
        block, arrived = self.buffer.add(Block.of(readings))
        return self.stream.add(block, self.newest.add(arrived))

    def flush(self) -> Events:
        """What the readings complete that wait for others."""
        return self.stream.add(self.buffer.flush())

    def reset(self) -> None:
        """Forget every reading."""
        self.buffer.reset()
        self.stream.reset()
        self.newest = NewestTrack(StreamSettings().max_gap, math.nan)


@pytest.fixture
def new_stream() -> Callable[..., Stream]:
    """A stream with these settings."""
    return Stream


def now(*moments: int) -> np.ndarray:
    """Moments."""
    return np.array(moments)


class Newest(Sample):
    """A sample of the newest moment."""


class Smoothed(Sample):
    """A sample that lies back."""


class MeasuredSample(NamedTuple):
    """A smoothed sample, and the battery power, W, measured at its moment."""

    sample: Sample
    power: float


StreamEvent: TypeAlias = Newest | Smoothed | MeasuredSample | Interval


def completed(stream: Stream, readings: Iterable[Reading]) -> list[StreamEvent]:
    """What readings complete, in order of stamps, taken as one block."""
    return in_order(stream.add(readings))


def in_order(events: Events) -> list[StreamEvent]:
    """Events in the order in which a learner follows them."""
    rows: list[tuple[tuple[int, int], StreamEvent]] = []
    newest = zip(events.newest.known_ns.tolist(), events.newest.samples.rows(), strict=True)
    rows += (((known_ns, 10**9), Newest(*sample)) for known_ns, sample in newest)
    smoothed = zip(events.smoothed_ns.tolist(), events.smoothed.rows(), strict=True)
    for index, (known_ns, sample) in enumerate(smoothed):
        rows.append(((known_ns, 2 * index + 1), Smoothed(*sample)))
    samples, power, known, place = events.measured
    for known_ns, turn, sample, watts in zip(
        known.tolist(), place.tolist(), samples.rows(), power.tolist(), strict=True
    ):
        rows.append(((known_ns, 2 * turn), MeasuredSample(sample, watts)))
    rows += [((known_ns, 10**8), interval) for known_ns, interval in events.intervals]
    return [event for _, event in sorted(rows, key=lambda row: row[0])]


@pytest.fixture
def play() -> Callable[[Stream, Iterable[Reading]], list[StreamEvent]]:
    """Everything a stream makes of readings of which no more will come."""

    def whole(stream: Stream, readings: Iterable[Reading]) -> list[StreamEvent]:
        return completed(stream, readings) + in_order(stream.flush())

    return whole
