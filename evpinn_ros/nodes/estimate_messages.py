"""What the estimator and the energy meter say, as ROS 2 messages, for nodes and bags alike."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from evpinn_ros.energy.meter import EnergyState
from evpinn_ros.estimation.estimate import ParameterSet, PowerEstimate, PowerKind
from evpinn_ros.nodes import topics
from evpinn_ros.nodes.messages import BadMessage, NewMessage, finite, named_vector, scalar
from evpinn_ros.nodes.topics import Topic
from evpinn_ros.vehicle.identifiable import IDENTIFIABLE_NAMES
from evpinn_ros.vehicle.linear_power import FEATURES, LinearPower

if TYPE_CHECKING:  # for its type alone: the energy node would load torch with it
    from evpinn_ros.estimation.estimator import Output

POWER_TOPICS = {
    PowerKind.MEASURED: topics.POWER_MEASURED,
    PowerKind.PREDICTED: topics.POWER_PREDICTED,
    PowerKind.SMOOTHED: topics.POWER_SMOOTHED,
}
MODEL_VERSION = 1  # of what `estimate/model` holds
_MODEL_ARRAYS = ("mean", "directions", "unit_speeds", "unit_accelerations")
_MODEL_NUMBERS = [f.name for f in fields(LinearPower) if f.name not in _MODEL_ARRAYS]
_POSITIVE = ("mass", "rotating_mass_factor", "drift_time", "slope_length")
FLOWS = ("measured", "predicted", "rknn", "regenerated")


def output_messages(new: NewMessage, output: Output) -> Iterator[tuple[Topic, Any]]:
    """Every message that one output of the estimator leads to.

    Raises:
        ValueError: a number is not finite; nothing of this output may then be published.
    """
    if isinstance(output, PowerEstimate):
        vector = named_vector(new, output.stamp_ns, ["power"], [output.power], [output.sigma])
        yield POWER_TOPICS[output.kind], vector
    else:
        yield from _parameter_messages(new, output)


def _parameter_messages(new: NewMessage, found: ParameterSet) -> Iterator[tuple[Topic, Any]]:
    names = list(found.parameters)
    values = [estimate.value for estimate in found.parameters.values()]
    sigmas = [estimate.std for estimate in found.parameters.values()]
    live = named_vector(new, found.stamp_ns, names, values, sigmas)
    yield topics.PARAMETERS, live
    yield (
        topics.IDENTIFIABLE,
        named_vector(
            new,
            found.stamp_ns,
            IDENTIFIABLE_NAMES,
            list(found.identifiable),
            list(found.identifiable_std),
        ),
    )
    bounds = {
        f"{name}_{end}": getattr(estimate, end)
        for name, estimate in found.parameters.items()
        for end in ("lower", "upper", "prior_share")
    }
    yield topics.BOUNDS, named_vector(new, found.stamp_ns, list(bounds), list(bounds.values()))
    if found.reliable:
        yield topics.RELIABLE, live
    for topic in topics.PARAMETER_SCALARS:
        name = topic.name.rpartition("/")[2]
        yield topic, scalar(new, found.parameters[name].value)


def energy_messages(new: NewMessage, state: EnergyState) -> Iterator[tuple[Topic, Any]]:
    """The messages of an energy state; a flow not known yet is left out of the vector."""
    flows = {name: getattr(state, name) for name in FLOWS}
    known = {
        name: flow
        for name, flow in flows.items()
        if math.isfinite(flow.energy) and math.isfinite(flow.power)
    }
    if known:
        yield (
            topics.ENERGY_STATE,
            named_vector(
                new,
                state.stamp_ns,
                list(known),
                [flow.energy for flow in known.values()],
                [flow.sigma for flow in known.values()],
                [flow.power for flow in known.values()],
            ),
        )
    yield topics.ENERGY_CONSUMED, scalar(new, state.consumed)


def model_message(new: NewMessage, vehicle: str, model: LinearPower) -> Any:
    """std_msgs/Float64MultiArray: all numbers of a model in a row.

    Its first dimension is labelled `vehicle/version` and spans all; one more for each part names
    it and tells its size.
    """
    parts = {"numbers": np.array([getattr(model, name) for name in _MODEL_NUMBERS])}
    parts |= {name: getattr(model, name).ravel() for name in _MODEL_ARRAYS}
    data = [finite(number) for number in np.concatenate(list(parts.values())).tolist()]
    sizes = {f"{vehicle}/{MODEL_VERSION}": len(data)}
    sizes |= {name: int(part.size) for name, part in parts.items()}
    dimensions = [
        new("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=size)
        for label, size in sizes.items()
    ]
    layout = new("std_msgs/msg/MultiArrayLayout", dim=dimensions)
    return new(topics.ARRAY_TYPE, layout=layout, data=data)


def read_model(message: Any, vehicle: str) -> LinearPower:
    """The model in a message.

    Raises:
        BadMessage: it is of another vehicle or version, or its numbers do not fit.
    """
    labels = {dimension.label: dimension.size for dimension in message.layout.dim}
    if next(iter(labels), None) != f"{vehicle}/{MODEL_VERSION}":
        raise BadMessage("other_vehicle_or_version")
    sizes = [labels.get(name, -1) for name in ("numbers", *_MODEL_ARRAYS)]
    data = np.array(message.data, dtype=float)
    if min(sizes) < 0 or sum(sizes) != data.size or sizes[0] != len(_MODEL_NUMBERS):
        raise BadMessage("lengths_differ")
    if not np.isfinite(data).all():
        raise BadMessage("not_finite")
    numbers, mean, directions, *units = np.split(data, np.cumsum(sizes[:-1]))
    wanted = len(FEATURES) + units[0].size * units[1].size
    if mean.size != wanted or directions.size % wanted or min(u.size for u in units) < 2:
        raise BadMessage("lengths_differ")
    named = dict(zip(_MODEL_NUMBERS, numbers.tolist(), strict=True))
    if min(named[name] for name in _POSITIVE) <= 0 or any((np.diff(u) <= 0).any() for u in units):
        raise BadMessage("out_of_range")
    return LinearPower(
        **named,
        mean=mean,
        directions=directions.reshape(-1, wanted),
        unit_speeds=units[0],
        unit_accelerations=units[1],
    )
