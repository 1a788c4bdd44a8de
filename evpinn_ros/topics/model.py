"""The car that predicts power, as a message: `estimate/model`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from evpinn_ros import topics
from evpinn_ros.core.energy.plausible import car_is_possible
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.states import SIZE
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.estimation.unevenness import SHAPE, Unevenness
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.topics.messages import BadMessage, NewMessage, finite

MODEL_VERSION = 4  # of what `estimate/model` holds
MOST_NUMBERS = 100_000  # of a model: twenty times what an estimator sends
UNKNOWN_CELSIUS = -1000.0  # for a message holds numbers only
MOST_SEED = 2**53  # a seed is a number of the message


def model_message(new: NewMessage, vehicle: str, car: CarModel) -> Any:
    """std_msgs/Float64MultiArray: all numbers of a car in a row.

    Its first dimension is labelled `vehicle/version` and spans all; one more for each part names
    it and tells its size.
    """
    celsius = UNKNOWN_CELSIUS if car.celsius is None else car.celsius
    uneven = car.unevenness
    numbers = car.equation.seed, car.load_variance, car.growth, car.trust, car.seconds
    parts = {
        "numbers": np.array([*numbers, celsius, float(car.reports), car.last_drive]),
        "noise": car.noise,
        "mean": car.mean,
        "covariance": car.covariance.ravel(),
        "uneven_metres": uneven.metres.ravel(),
        "uneven_rows": uneven.rows.ravel(),
        "uneven_scatter": np.array([uneven.squares, uneven.drives]),
    }
    data = [finite(number) for number in np.concatenate(list(parts.values())).tolist()]
    sizes = {f"{vehicle}/{MODEL_VERSION}": len(data)}
    sizes |= {name: int(part.size) for name, part in parts.items()}
    dimensions = [
        new("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=size)
        for label, size in sizes.items()
    ]
    layout = new("std_msgs/msg/MultiArrayLayout", dim=dimensions)
    return new(topics.ARRAY_TYPE, layout=layout, data=data)


def read_model(message: Any, vehicle: Vehicle) -> CarModel:
    """The car in a message.

    Raises:
        BadMessage: it is of another vehicle or version, or its numbers do not fit.
    """
    if max(len(message.data), len(message.layout.dim)) > MOST_NUMBERS:
        raise BadMessage("too_large")
    labels = {dimension.label: dimension.size for dimension in message.layout.dim}
    if next(iter(labels), None) != f"{vehicle.key}/{MODEL_VERSION}":
        raise BadMessage("other_vehicle_or_version")
    wanted = {"numbers": 8, "noise": 3, "mean": SIZE, "covariance": SIZE**2}
    classes = math.prod(SHAPE)
    wanted |= {"uneven_metres": classes, "uneven_rows": classes * SIZE, "uneven_scatter": 2}
    data = np.array(message.data, dtype=float)
    if {name: labels.get(name) for name in wanted} != wanted or sum(wanted.values()) != data.size:
        raise BadMessage("lengths_differ")
    if not np.isfinite(data).all():
        raise BadMessage("not_finite")
    numbers, noise, mean, covariance, metres, rows, scatter = np.split(
        data, np.cumsum([*wanted.values()])[:-1]
    )
    seed, load_variance, growth, trust, seconds, celsius, reports, last_drive = numbers.tolist()
    if not 0.0 <= seed <= MOST_SEED or not math.isclose(seed, int(seed)):
        raise BadMessage("out_of_range")
    car = CarModel(
        equation=equation_of(vehicle, int(seed)),
        mean=mean,
        covariance=covariance.reshape(SIZE, SIZE),
        noise=noise,
        load_variance=load_variance,
        growth=growth,
        trust=trust,
        seconds=seconds,
        celsius=None if celsius == UNKNOWN_CELSIUS else celsius,
        reports=bool(reports),
        unevenness=Unevenness(
            metres.reshape(SHAPE), rows.reshape(*SHAPE, SIZE), *scatter.tolist()
        ),
        last_drive=last_drive,
    )
    if not car_is_possible(car):
        raise BadMessage("out_of_range")
    return car
