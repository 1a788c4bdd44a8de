"""The model that predicts power, as a message: `estimate/model`."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from evpinn_ros import topics
from evpinn_ros.energy.plausible import car_is_possible
from evpinn_ros.topics.messages import BadMessage, NewMessage, finite
from evpinn_ros.vehicle.linear_power import FEATURES, LinearPower

MODEL_VERSION = 2  # of what `estimate/model` holds
MOST_NUMBERS = 100_000  # of a model: thirty times what an estimator tells
_ARRAYS = ("mean", "directions")
_NUMBERS = [f.name for f in fields(LinearPower) if f.name not in _ARRAYS]


def model_message(new: NewMessage, vehicle: str, model: LinearPower) -> Any:
    """std_msgs/Float64MultiArray: all numbers of a model in a row.

    Its first dimension is labelled `vehicle/version` and spans all; one more for each part names
    it and tells its size.
    """
    parts = {"numbers": np.array([getattr(model, name) for name in _NUMBERS])}
    parts |= {name: getattr(model, name).ravel() for name in _ARRAYS}
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
    if max(len(message.data), len(message.layout.dim)) > MOST_NUMBERS:
        raise BadMessage("too_large")
    labels = {dimension.label: dimension.size for dimension in message.layout.dim}
    if next(iter(labels), None) != f"{vehicle}/{MODEL_VERSION}":
        raise BadMessage("other_vehicle_or_version")
    sizes = [labels.get(name, -1) for name in ("numbers", *_ARRAYS)]
    data = np.array(message.data, dtype=float)
    if min(sizes) < 0 or sum(sizes) != data.size or sizes[0] != len(_NUMBERS):
        raise BadMessage("lengths_differ")
    if not np.isfinite(data).all():
        raise BadMessage("not_finite")
    numbers, mean, directions = np.split(data, np.cumsum(sizes[:-1]))
    wanted = len(FEATURES)
    if mean.size != wanted or directions.size % wanted:
        raise BadMessage("lengths_differ")
    named = dict(zip(_NUMBERS, numbers.tolist(), strict=True))
    car = LinearPower(**named, mean=mean, directions=directions.reshape(-1, wanted))
    if not car_is_possible(car):
        raise BadMessage("out_of_range")
    return car
