"""Converts readings to the input topics of a bag, and back."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

from evpinn_ros import topics
from evpinn_ros.bags.reader import BagReader, Record
from evpinn_ros.bags.types import new_message
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.common.errors import SAY_CAR, InputError, near_names
from evpinn_ros.core.signals.readings import Reading
from evpinn_ros.topics import NAMESPACE, Topic, topic_of
from evpinn_ros.topics.messages import BadMessage
from evpinn_ros.topics.readings import (
    READING_TOPICS,
    Batteries,
    ChargeScale,
    Rotation,
    in_frame_of_map,
    reading_messages,
    to_reading,
)

NOT_A_MESSAGE = "not_finite_or_out_of_range"


def write_readings(
    readings: Iterable[Reading], writer: BagWriter, namespace: str = NAMESPACE
) -> Counter[str]:
    """Write each reading at its stamp; returns counts of omitted readings by reason."""
    dropped: Counter[str] = Counter()
    for reading in readings:
        try:
            messages = list(reading_messages(new_message, reading))
        except ValueError:
            dropped[NOT_A_MESSAGE] += 1
            continue
        for topic, message in messages:
            writer.write(topic.under(namespace), message, reading.stamp_ns)
    return dropped


class NoTopicsError(InputError):
    """The bag has none of the input topics."""


class BagReadings:
    """The readings of a bag, from the input topics under any namespace."""

    def __init__(
        self, reader: BagReader, car: str | None = None, mounting: Rotation | None = None
    ) -> None:
        """Find the input topics by name and type, in the namespace `car` if given.

        `mounting` is the rotation of the IMU, see `grade_reading`. NoTopicsError: the bag has no
        input topic; InputError: it has topics of several cars.
        """
        self.dropped: Counter[str] = Counter()  # unusable messages, by reason
        self.doubts: tuple[str, ...] = ()  # why totals are uncertain; complete once read
        self._reader, self._mounting = reader, mounting
        speeds = (_named(reader, topic, car) for topic in topics.SPEEDS)
        wanted_topics = [topic for topic in READING_TOPICS.values() if topic is not topics.SPEED]
        names = [next(filter(None, speeds), None)]
        names += [_named(reader, topic, car) for topic in wanted_topics]
        self.topics = tuple(name for name in names if name)  # full names of topics read
        missing = {topics.SPEED, topics.BATTERY} - {topic_of(name) for name in self.topics}
        if names[0]:
            missing.discard(topics.SPEED)  # another topic gives the speed
        self.notes = tuple(_near_topics(reader, missing))
        if not self.topics:
            wanted = ", ".join(topic.name for topic in READING_TOPICS.values())
            near = "".join(f"; {note}" for note in self.notes)
            raise NoTopicsError(f"{reader.path}: has none of the topics {wanted}{near}")

    def __iter__(self) -> Iterator[Reading]:
        """The readings in order of log time; unusable messages are counted in `dropped`."""
        self.dropped.clear()
        charge, batteries = ChargeScale(), Batteries()
        self.doubts = ()
        for record in self._reader.records(self.topics):
            self._look_at(record, batteries)
            try:
                reading = to_reading(record.type_name, record.message, self._mounting)
                yield charge.reading(reading)
            except BadMessage as error:
                self.dropped[error.reason] += 1
        self.dropped.update(self._reader.dropped)
        if batteries.take_turns:
            names = " and ".join(batteries.names)
            self.doubts = (
                f"the batteries {names} take turns on {topics.BATTERY.name}, so every energy is "
                "wrong: record each under a topic of its own",
            )

    def _look_at(self, record: Record, batteries: Batteries) -> None:
        """Note a speed in the frame of a map, and the battery that sent a message."""
        if record.type_name == topics.BATTERY_TYPE:
            batteries.add(record.message)
        elif record.type_name == topics.ODOMETRY_TYPE and in_frame_of_map(record.message):
            frame = record.message.header.frame_id
            note = (
                f"{record.topic}: the twist is in the frame of the pose, {frame!r}, so its "
                "magnitude is the speed: driving in reverse counts as forward"
            )
            self.notes = tuple(dict.fromkeys((*self.notes, note)))


def _near_topics(reader: BagReader, missing: Iterable[Topic]) -> Iterator[str]:
    wanted = {topic.name: topic for topic in missing}
    for name, info in reader.topics.items():
        near = near_names("/".join(name.split("/")[-2:]), wanted)
        if topic := next((topic for topic in wanted.values() if topic.matches(name)), None):
            yield f"{name} is not read: its type is {info.type_name}, not {topic.type_name}"
        elif near:
            yield f"topic {name} is not known{near}"


def _named(reader: BagReader, topic: Topic, car: str | None) -> str | None:
    names = [
        name
        for name, info in reader.topics.items()
        if info.type_name == topic.type_name
        and (topic.matches(name) if car is None else name == topic.under(f"/{car.strip('/')}"))
    ]
    if len(names) > 1:
        cars = ", ".join(name.removesuffix(f"/{topic.name}") or "/" for name in names)
        raise InputError(f"{reader.path}: topics of {len(names)} cars, {cars}; {SAY_CAR}")
    return names[0] if names else None
