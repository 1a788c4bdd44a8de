"""Converts a learned car model to a message of `estimate/model`, and back.

The message has the declared fields of `CarModel`, except the equation: the receiver makes it from
its vehicle file, the seed of the network and the relative size.
"""

from __future__ import annotations

from dataclasses import is_dataclass
import math
from typing import Any, cast

import numpy as np

from evpinn_ros import topics
from evpinn_ros.common.saved_fields import declared
from evpinn_ros.core.energy.plausible import car_is_possible
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.vehicle.files import CONSTANTS, Vehicle
from evpinn_ros.topics.messages import BadMessage, NewMessage, finite

MODEL_VERSION = 5  # of the content of `estimate/model`
MOST_NUMBERS = 100_000  # of a model: twenty times as many as an estimator sends
MOST_SEED = 2**53  # a seed is sent as a float64
SEED, RELATIVE_SIZE = "seed", "relative_size"


def model_message(new: NewMessage, vehicle: str, car: CarModel) -> Any:
    """std_msgs/Float64MultiArray of a car model; ValueError if a number is not finite.

    The first dimension has the label `vehicle/version`; each other names a field and its number of
    elements, 0 for None.
    """
    equation = {SEED: car.equation.seed, RELATIVE_SIZE: car.equation.vehicle.relative_size}
    parts = {name: np.array([float(value)]) for name, value in equation.items()} | _parts(car)
    data = [finite(number) for number in np.concatenate(list(parts.values())).tolist()]
    sizes = {f"{vehicle}/{MODEL_VERSION}": len(data)}
    sizes |= {name: part.size for name, part in parts.items()}
    dimensions = [
        new("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=size)
        for label, size in sizes.items()
    ]
    layout = new("std_msgs/msg/MultiArrayLayout", dim=dimensions)
    return new(topics.ARRAY_TYPE, layout=layout, data=data)


def read_model(message: Any, vehicle: Vehicle) -> CarModel:
    """The car model in a message; BadMessage for another vehicle or version, or bad numbers."""
    if max(len(message.data), len(message.layout.dim)) > MOST_NUMBERS:
        raise BadMessage("too_large")
    sizes = {dimension.label: dimension.size for dimension in message.layout.dim}
    if next(iter(sizes), None) != f"{vehicle.key}/{MODEL_VERSION}":
        raise BadMessage("other_vehicle_or_version")
    data = np.array(message.data, dtype=float)
    if not np.isfinite(data).all():
        raise BadMessage("not_finite")
    ends = np.cumsum([*sizes.values()][1:])
    if not ends.size or min(sizes.values()) < 0 or ends[-1] != data.size:
        raise BadMessage("lengths_differ")
    parts = dict(zip([*sizes][1:], np.split(data, ends[:-1]), strict=True))
    seed = float(_number(parts.get(SEED, data)))
    if not 0.0 <= seed <= MOST_SEED or not math.isclose(seed, int(seed)):
        raise BadMessage("out_of_range")
    size = float(_number(parts.get(RELATIVE_SIZE, np.array([vehicle.relative_size]))))
    if not CONSTANTS[RELATIVE_SIZE].lower <= size <= CONSTANTS[RELATIVE_SIZE].upper:
        raise BadMessage("out_of_range")
    vehicle = vehicle.of_size(size)
    car: CarModel = _value(CarModel, parts, "", equation=equation_of(vehicle, int(seed)))
    if not car_is_possible(car):
        raise BadMessage("out_of_range")
    return car


def _parts(value: Any, prefix: str = "") -> dict[str, np.ndarray]:
    parts = {}
    for name, field in declared(cast("Any", type(value))).items():
        content = getattr(value, name)
        if field.range is not None or field.kind is bool:
            numbers = () if content is None else np.ravel(content)
            parts[prefix + name] = np.array(numbers, dtype=float)
        elif is_dataclass(content) and name != "equation":
            parts |= _parts(content, f"{prefix}{name}.")
    return parts


def _value(kind: Any, parts: dict[str, np.ndarray], prefix: str, **given: Any) -> Any:
    """An instance of `kind` from numbers by field name; other names are ignored."""
    values = dict(given)
    for name, field in declared(kind).items():
        numbers = parts.get(prefix + name)
        if name in given:
            continue
        if is_dataclass(field.kind):
            values[name] = _value(field.kind, parts, f"{prefix}{name}.")
        elif numbers is None:
            if not field.lackable:
                raise BadMessage("lengths_differ")
        elif field.kind is np.ndarray and field.range is not None:
            if numbers.size != math.prod(shape := field.range.shape):
                raise BadMessage("lengths_differ")
            values[name] = numbers.reshape(shape)
        else:
            none = field.optional and not numbers.size
            values[name] = None if none else field.kind(_number(numbers))
    return kind(**values)


def _number(numbers: np.ndarray) -> float:
    if numbers.size != 1:
        raise BadMessage("lengths_differ")
    return float(numbers[0])
