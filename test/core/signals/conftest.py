from collections.abc import Callable, Iterable
from typing import NamedTuple, TypeAlias

import numpy as np
import pytest

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading
from evpinn_ros.core.signals.sample import Sample
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings
from evpinn_ros.core.signals.track import LATER

START = 1_700_000_000 * NANOSECONDS


def stamp_at(seconds: float) -> int:
    """The stamp this many seconds after the start."""
    return START + round(seconds * NANOSECONDS)


@pytest.fixture
def at() -> Callable[[float], int]:
    """The stamp this many seconds after the start."""
    return stamp_at


@pytest.fixture
def new_stream() -> Callable[..., SampleStream]:
    """A stream with these settings, and an air density of 1.2 kg/m^3."""
    return lambda **settings: SampleStream(StreamSettings(**settings), 1.2)


def now(*moments: int) -> tuple[np.ndarray, np.ndarray]:
    """Moments, and that all that came may be used."""
    return np.array(moments), np.full(len(moments), LATER)


class Newest(Sample):
    """A sample of the newest moment."""


class Smoothed(Sample):
    """A sample that lies back."""


class MeasuredSample(NamedTuple):
    """A smoothed sample, and the battery power, W, measured at its moment."""

    sample: Sample
    power: float


StreamEvent: TypeAlias = Newest | Smoothed | MeasuredSample | Interval


def completed(stream: SampleStream, readings: Iterable[Reading]) -> list[StreamEvent]:
    """What readings complete, in order, taken as one block."""
    block = stream.add_block(Block.of(readings))
    rows: list[tuple[tuple[int, int], StreamEvent]] = []
    for order, sample in zip(block.newest_order.tolist(), block.newest.rows(), strict=True):
        rows.append(((order, -1), Newest(*sample)))
    smoothed = zip(block.smoothed_order.tolist(), block.smoothed.rows(), strict=True)
    for index, (order, sample) in enumerate(smoothed):
        rows.append(((order, 2 * index + 1), Smoothed(*sample)))
    order, place, samples, power = block.measured
    for at, turn, sample, watts in zip(
        order.tolist(), place.tolist(), samples.rows(), power.tolist(), strict=True
    ):
        rows.append(((at, 2 * turn), MeasuredSample(sample, watts)))
    rows += [((at, 10**9), interval) for at, interval in block.intervals]
    return [event for _, event in sorted(rows, key=lambda row: row[0])]


@pytest.fixture
def play() -> Callable[[SampleStream, Iterable[Reading]], list[StreamEvent]]:
    """Everything a stream makes of readings."""
    return completed
