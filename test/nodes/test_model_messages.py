"""The topic `estimate/model`: what is sent is what is heard, and nothing else is believed."""

import dataclasses

import numpy as np
import pytest

from evpinn_ros.bags.types import decode, encode, new_message
from evpinn_ros.estimation.pinn import PinnLearner
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.messages import BadMessage
from evpinn_ros.nodes.model_messages import MOST_NUMBERS, model_message, read_model
from evpinn_ros.vehicle.files import load_vehicle

CAR = load_vehicle("bmw_i3")
MODEL = PinnLearner(CAR).linear_power(None)


@pytest.mark.parametrize("new", [new_message, factory.new_message])
def test_a_model_survives_the_message(new):
    message = model_message(new, "bmw_i3", MODEL)
    if new is new_message:
        message = decode(message.__msgtype__, encode(message))
    found = read_model(message, "bmw_i3")
    for field in dataclasses.fields(MODEL):
        assert np.array_equal(getattr(found, field.name), getattr(MODEL, field.name)), field.name


def changed(**values):
    return model_message(new_message, "bmw_i3", dataclasses.replace(MODEL, **values))


def shorter():
    message = model_message(new_message, "bmw_i3", MODEL)
    message.data = message.data[:-1]
    return message


def not_finite():
    message = model_message(new_message, "bmw_i3", MODEL)
    message.data[100] = np.nan
    return message


def without_layout():
    message = model_message(new_message, "bmw_i3", MODEL)
    message.layout.dim = []
    return message


def far_too_long():
    message = model_message(new_message, "bmw_i3", MODEL)
    message.data = np.zeros(MOST_NUMBERS + 1)
    return message


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: model_message(new_message, "nissan_leaf", MODEL), "other_vehicle_or_version"),
        (without_layout, "other_vehicle_or_version"),
        (shorter, "lengths_differ"),
        (far_too_long, "too_large"),
        (lambda: changed(mean=MODEL.mean[:-1]), "lengths_differ"),
        (lambda: changed(directions=MODEL.directions[:, :-1]), "lengths_differ"),
        (not_finite, "not_finite"),
        (lambda: changed(mass=-1.0), "out_of_range"),
        (lambda: changed(drift_time=0.0), "out_of_range"),
    ],
)
def test_what_is_no_model_of_this_car_is_refused(make, reason):
    with pytest.raises(BadMessage) as error:
        read_model(make(), "bmw_i3")
    assert error.value.reason == reason


def test_a_number_that_is_not_finite_is_not_sent():
    with pytest.raises(ValueError, match="finite"):
        changed(mean=MODEL.mean * np.nan)
