"""Typed messages of `evpinn_msgs`, beside the named vectors.

In topics under `typed/` each quantity is a field, with fields for its 1-sigma and, for some, its
rate; NaN if unknown.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from evpinn_ros import topics
from evpinn_ros.core.energy.plan import CONDITION_RANGES, PlanConditions
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.topics import Topic

PACKAGE = "evpinn_msgs"
PLAN_SERVICE = f"{PACKAGE}/srv/EstimatePlan"
PLAN_ACTION = f"{PACKAGE}/action/EstimatePlans"
PLAN_RESULT = f"{PACKAGE}/msg/PlanResult"
PLAN_CONDITIONS = f"{PACKAGE}/msg/PlanConditions"
SIGMA, RATE = "_sigma", "_rate"


def typed(topic: Topic, name: str) -> Topic:
    """The typed topic beside a topic."""
    text = f"`{topic.name}` as `{PACKAGE}/{name}`"
    type_name = f"{PACKAGE}/msg/{name}"
    return Topic(
        f"{topics.TYPED}/{topic.name}", topic.source, text, topic.unit, type_name, topic.latched
    )


TYPED = {
    topic: typed(topic, name)
    for topic, name in (
        (topics.PARAMETERS, "VehicleParameters"),
        (topics.IDENTIFIABLE, "IdentifiableCombinations"),
        (topics.POWER_MEASURED, "BatteryPower"),
        (topics.POWER_PREDICTED, "BatteryPower"),
        (topics.POWER_SMOOTHED, "BatteryPower"),
        (topics.ENERGY_BREAKDOWN, "EnergyBreakdown"),
        (topics.ENERGY_STATE, "BatteryEnergy"),
        (topics.ENERGY_CONSUMPTION, "EnergyConsumption"),
        (topics.ENERGY_RANGE, "RemainingRange"),
    )
}
ALWAYS = (topics.IDENTIFIABLE, topics.POWER_MEASURED, topics.POWER_SMOOTHED)
"""Published also without `named_vectors`, because the node `energy` subscribes to them."""
TYPED_FORECAST = typed(topics.FORECAST, "PlanForecast")


def quantities(message: Any) -> list[str]:
    """Names of all numbers in a typed message or its class."""
    return [name for name in message.get_fields_and_field_types() if name != "header"]


def typed_message(topic: Topic, vector: Any) -> Any:
    """The typed message of a topic of `TYPED`, with header and numbers of its named vector."""
    numbers = {
        f"{name}{end}": value
        for end, values in (("", vector.position), (RATE, vector.velocity), (SIGMA, vector.effort))
        for name, value in zip(vector.name, values, strict=False)
    }
    message = new_message(TYPED[topic].type_name, header=vector.header)
    for name in quantities(message):
        setattr(message, name, numbers.get(name, math.nan))
    return message


def given_conditions(message: Any) -> PlanConditions:
    """Conditions in a typed message, NaN if not given; PlanError for impossible ones."""
    given = {name: number for name in CONDITION_RANGES for number in getattr(message, name)}
    return PlanConditions(**{k: v for k, v in given.items() if not math.isnan(v)})


def assumed_conditions(assumed: Mapping[str, float]) -> Any:
    """The typed message of the conditions assumed in a forecast, by name."""
    return new_message(
        PLAN_CONDITIONS, **{name: [float(value)] for name, value in assumed.items()}
    )
