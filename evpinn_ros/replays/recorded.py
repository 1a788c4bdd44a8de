"""A recorded run of the nodes back to series: what the topics of a bag say, as a `Drive`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from evpinn_ros import topics
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.replays.history import Drive, History
from evpinn_ros.topics import Topic, topic_of
from evpinn_ros.topics.estimates import (
    POWER_KINDS,
    read_breakdown,
    read_energy,
    read_parameters,
    read_power,
)
from evpinn_ros.topics.messages import BadMessage
from evpinn_ros.topics.readings import ChargeScale, to_reading


def recorded_drive(bag: Path) -> Drive:
    """The series of a bag that was recorded from the nodes, or written by a replay.

    Raises:
        InputError: it is no bag.
    """
    history, charge = History(), ChargeScale()
    parameters: Any = None
    combined: Any = None
    with BagReader(bag) as reader:
        names = {topic_of(name) for name in reader.topics}
        speed = next((topic for topic in topics.SPEEDS if topic in names), topics.SPEED)
        for record in reader.records():
            topic = topic_of(record.topic)
            try:
                if topic in (speed, topics.BATTERY):
                    reading = to_reading(record.type_name, record.message)
                    history.add_reading(charge.reading(reading))
                elif topic is topics.PARAMETERS:
                    parameters = record.message
                elif topic is topics.IDENTIFIABLE:
                    combined = record.message
                elif topic is topics.BOUNDS and parameters is not None and combined is not None:
                    history.add_output(read_parameters(parameters, combined, record.message))
                elif topic is topics.ENERGY_BREAKDOWN:
                    history.add_breakdown(read_breakdown(record.message))
                elif topic is not None:
                    _add_output(history, topic, record.message)
            except BadMessage:
                continue  # a message of somebody else's: there is nothing of ours to draw
    return history.drive()


def _add_output(history: History, topic: Topic, message: Any) -> None:
    if topic in POWER_KINDS:
        history.add_output(read_power(topic, message))
    elif topic is topics.ENERGY_STATE:
        history.add_output(read_energy(message))
