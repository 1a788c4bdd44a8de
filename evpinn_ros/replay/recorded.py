"""A recorded run of the nodes back to series: what the topics of a bag say, as a `Drive`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from evpinn_ros import topics
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.energy.meter import EnergyState, Flow
from evpinn_ros.estimation.estimate import (
    ParameterEstimate,
    ParameterSet,
    PowerEstimate,
    Trust,
)
from evpinn_ros.replay.history import Drive, History
from evpinn_ros.topics import Topic, topic_of
from evpinn_ros.topics.estimates import FLOWS, POWER_TOPICS
from evpinn_ros.topics.messages import BadMessage, read_named_vector
from evpinn_ros.topics.readings import to_reading
from evpinn_ros.vehicle.identifiable import Identifiable
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES

KINDS = {topic: kind for kind, topic in POWER_TOPICS.items()}
UNKNOWN = Flow(math.nan, math.nan, math.nan)
NOT_READ = Identifiable(*([math.nan] * len(Identifiable._fields)))


def recorded_drive(bag: Path) -> Drive:
    """The series of a bag that was recorded from the nodes, or written by a replay.

    Raises:
        InputError: it is no bag.
    """
    history = History()
    parameters: Any = None
    with BagReader(bag) as reader:
        has_speed = any(topics.SPEED.matches(name) for name in reader.topics)
        speed = topics.SPEED if has_speed else topics.ODOMETRY
        for record in reader.records():
            topic = topic_of(record.topic)
            try:
                if topic in (speed, topics.BATTERY):
                    history.add_reading(to_reading(record.type_name, record.message))
                elif topic is topics.PARAMETERS:
                    parameters = record.message
                elif topic is topics.BOUNDS and parameters is not None:
                    history.add_output(_parameter_set(parameters, record.message))
                elif topic is not None:
                    _add_output(history, topic, record.message)
            except BadMessage:
                continue  # a message of somebody else's: there is nothing of ours to draw
    return history.drive()


def _add_output(history: History, topic: Topic, message: Any) -> None:
    if topic in KINDS:
        vector = read_named_vector(message)
        sigma = vector.sigmas.get("power", math.nan)
        kind = KINDS[topic]
        history.add_output(PowerEstimate(kind, vector.stamp_ns, vector.values["power"], sigma))
    elif topic is topics.ENERGY_STATE:
        vector = read_named_vector(message)
        flows = {
            name: Flow(vector.values[name], vector.rates[name], vector.sigmas.get(name, math.nan))
            if name in vector.values
            else UNKNOWN
            for name in FLOWS
        }
        history.add_output(
            EnergyState(
                stamp_ns=vector.stamp_ns,
                **flows,
                consumed=math.nan,
                consumed_sigma=math.nan,
                gaps=0,
                dropped=0,
                unmeasured_s=math.nan,
                unknown_s=math.nan,
                measuring="measured" in vector.values,
            )
        )


def _parameter_set(parameters: Any, bounds: Any) -> ParameterSet:
    """Parameters and the bounds published with them; their states are not on the topics."""
    live, limits = read_named_vector(parameters), read_named_vector(bounds).values
    estimates = {
        name: ParameterEstimate(
            value=live.values[name],
            std=live.sigmas.get(name, math.nan),
            prior_share=limits[f"{name}_prior_share"],
            lower=limits[f"{name}_lower"],
            upper=limits[f"{name}_upper"],
            state=Trust.ESTIMATING,
        )
        for name in PARAMETER_NAMES
    }
    return ParameterSet(live.stamp_ns, estimates, NOT_READ, NOT_READ, reliable=False)
