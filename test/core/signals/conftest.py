from collections.abc import Callable, Iterable

import pytest

from evpinn_ros.core.signals.readings import NANOSECONDS, Reading
from evpinn_ros.core.signals.sample import StreamEvent
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings

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


@pytest.fixture
def play() -> Callable[[SampleStream, Iterable[Reading]], list[StreamEvent]]:
    """Everything a stream makes of readings."""
    return lambda stream, readings: [
        e for reading in readings for e in stream.add_reading(reading)
    ]
