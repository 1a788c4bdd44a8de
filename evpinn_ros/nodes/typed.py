"""The typed interface: the messages of `evpinn_msgs`, from the same contract as the others.

A typed topic repeats a named vector under `typed/`: each quantity is a field, beside it its
1-sigma and, where the vector has one, its rate; NaN where not known. `definition` is what the
`.msg` files say. Nothing here needs `evpinn_msgs` until it is installed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
import math
from typing import Any

from evpinn_ros import topics
from evpinn_ros.topics import Topic
from evpinn_ros.topics.messages import NewMessage

PACKAGE = "evpinn_msgs"
PLAN_SERVICE = "EstimatePlan"
SIGMA, RATE = "_sigma", "_rate"


@dataclass(frozen=True, slots=True)
class Layout:
    """A typed message of named quantities.

    Attributes:
        name: of the message.
        text: what it is, in one line.
        quantities: by name, with unit and meaning.
        rates: whether each has a rate beside.
    """

    name: str
    text: str
    quantities: Mapping[str, str]
    rates: bool = False

    @property
    def fields(self) -> list[str]:
        """Names of all numbers."""
        ends = ("", RATE, SIGMA) if self.rates else ("", SIGMA)
        return [f"{name}{end}" for name in self.quantities for end in ends]


POWER = Layout(
    "Power",
    "Battery power, positive when drawn.",
    {"power": "W", "unmeasured_energy": "J predicted since the battery was last measured"},
)
LAYOUTS: Mapping[Topic, Layout] = {
    topics.PARAMETERS: Layout(
        "Parameters",
        "Live parameters of the car.",
        {
            "eta": "1, drive efficiency",
            "mu": "1, regeneration efficiency",
            "mass": "kg",
            "c_rr": "1, rolling resistance",
            "c_d": "1, drag coefficient",
            "p_aux": "W, standing load",
        },
    ),
    topics.POWER_MEASURED: POWER,
    topics.POWER_PREDICTED: POWER,
    topics.POWER_SMOOTHED: POWER,
    topics.ENERGY_STATE: Layout(
        "Energy",
        "Energy since the last reset, positive when drawn from the battery; rates are powers.",
        {
            "measured": "J, by voltage and current",
            "predicted": "J, from speed alone",
            "rknn": "J, predicted, by the Runge-Kutta network",
            "regenerated": "J",
            "consumed": "J, measured where possible, predicted elsewhere",
        },
        rates=True,
    ),
    topics.ENERGY_RANGE: Layout(
        "Range",
        "What is left in the battery.",
        {
            "distance_to_empty": "m",
            "distance_lower": "m, of its 90 % band",
            "distance_upper": "m",
            "usable_energy": "J",
            "state_of_charge": "1",
            "capacity": "J",
        },
    ),
}


def typed(topic: Topic, name: str) -> Topic:
    """The typed topic beside one of the contract."""
    text = f"`{topic.name}` as `{PACKAGE}/{name}`"
    type_name = f"{PACKAGE}/msg/{name}"
    return Topic(f"typed/{topic.name}", type_name, topic.source, text, topic.unit, topic.latched)


TYPED = {topic: typed(topic, layout.name) for topic, layout in LAYOUTS.items()}
TYPED_FORECAST = typed(topics.FORECAST, "Forecast")


def definition(layout: Layout) -> str:
    """The `.msg` file of a layout."""
    lines = [
        f"# {layout.text} NaN: not known. `_sigma` is 1-sigma{' of the value' * layout.rates}."
    ]
    lines.append("std_msgs/Header header")
    for name, meaning in layout.quantities.items():
        lines.append(f"float64 {name}  # {meaning}")
        lines += [f"float64 {name}{RATE}"] * layout.rates + [f"float64 {name}{SIGMA}"]
    return "\n".join(lines) + "\n"


def is_installed() -> bool:
    """True if `evpinn_msgs` is there, and not merely its source in the folder of a checkout."""
    found = find_spec(PACKAGE)
    return found is not None and found.origin is not None


def typed_message(new: NewMessage, topic: Topic, vector: Any) -> Any:
    """The typed message of a named vector, whose header and numbers it repeats.

    Args:
        new: makes messages.
        topic: of the vector, a key of `TYPED`.
        vector: sensor_msgs/JointState.
    """
    numbers = dict.fromkeys(LAYOUTS[topic].fields, math.nan)
    for end, values in (("", vector.position), (RATE, vector.velocity), (SIGMA, vector.effort)):
        for name, value in zip(vector.name, values, strict=False):
            if f"{name}{end}" in numbers:
                numbers[f"{name}{end}"] = value
    return new(TYPED[topic].type_name, header=vector.header, **numbers)
