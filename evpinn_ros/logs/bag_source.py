"""A bag of our topics as a recorded drive."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from evpinn_ros.bags.convert import BagReadings, NoTopicsError
from evpinn_ros.bags.metadata import stated_seconds
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.core.signals.block import Block
from evpinn_ros.logs.battery_watch import BatteryWatch
from evpinn_ros.logs.read_options import READ_DEFAULTS, ReadOptions
from evpinn_ros.logs.source import Source
from evpinn_ros.topics import FRAME_TYPE

_SENT = "to_can_bus"  # topic to which ros2_socketcan listens for frames to send


class BagSource(Source):
    """A rosbag2 folder, a bare `.mcap` or `.db3`."""

    def __init__(self, path: Path, options: ReadOptions = READ_DEFAULTS) -> None:
        super().__init__(path)
        self._options, self._terrain = options, options.terrain
        self._open()

    def _open(self) -> None:
        self._reader = BagReader(self.path)
        self._readings = BagReadings(self._reader, self._options.car, self._options.mounting)
        self.dropped = self._readings.dropped
        self._watch = BatteryWatch(self.dropped)
        self._is_read = False

    @property
    def seconds(self) -> float | None:
        """Length that the bag's metadata states, s."""
        return stated_seconds(self.path)

    @property
    def problem(self) -> str | None:
        """Losses of the bag, in one line."""
        return self._reader.problem

    @property
    def notes(self) -> tuple[str, ...]:
        """Unread files, topics named almost as a missing one, implausible battery values."""
        readings = self._readings
        return *self._reader.notes, *readings.notes, *readings.doubts, *self._watch.notes

    @property
    def doubts(self) -> tuple[str, ...]:
        """Implausible battery values that make totals of energy uncertain."""
        return *self._readings.doubts, *self._watch.doubts

    def read(self) -> Iterator[Block]:
        """The readings in order of log time."""
        if self._is_read:  # a broken bag can be read again
            self._open()
        self._is_read = True
        with self._reader:
            blocks = self._watch.on(self._readings)
            yield from blocks if self._terrain is None else map(self._terrain.over, blocks)


def bag_of_topics(path: Path, options: ReadOptions) -> BagSource | None:
    """A bag with our topics; None if raw frames are to be read instead.

    InputError: no bag, neither of both, or topics of several cars.
    """
    if options.can_profile is not None and holds_frames(path, options.car):
        return None
    try:
        return BagSource(path, options)
    except NoTopicsError:
        if holds_frames(path, options.car):
            return None
        raise


def holds_frames(path: Path, car: str | None = None) -> bool:
    """True if a bag has raw frames, of the car if given; InputError if the path is no bag."""
    with BagReader(path) as reader:
        return bool(frame_topics(reader, car))


def frame_topics(reader: BagReader, car: str | None = None) -> list[str]:
    """Topics with received frames, of the car with this namespace if given."""
    begin = f"/{car.strip('/')}/" if car else ""
    return [
        name
        for name, info in reader.topics.items()
        if info.type_name == FRAME_TYPE and name.startswith(begin) and not name.endswith(_SENT)
    ]
