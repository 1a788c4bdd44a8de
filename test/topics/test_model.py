"""The topic `estimate/model`: what is sent is what is received, and nothing else is used."""

import dataclasses

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.bags.types import new_message
from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import LONGEST, plan_from_speed_profile
from evpinn_ros.core.energy.plausible import car_is_possible
from evpinn_ros.core.energy.power_model import PowerModel, Weather, vehicle_model
from evpinn_ros.core.estimation.size import model_of_file
from evpinn_ros.core.vehicle.files import load_vehicle, vehicle_names
from evpinn_ros.topics.messages import BadMessage
from evpinn_ros.topics.model import MOST_NUMBERS, model_message, read_model

CAR = load_vehicle("bmw_i3")
MODEL = dataclasses.replace(model_of_file(CAR, 3), last_drive=1800.0)


def changed(**values):
    return model_message(new_message, "bmw_i3", dataclasses.replace(MODEL, **values))


def uneven(**values):
    return changed(unevenness=dataclasses.replace(MODEL.unevenness, **values))


def with_data(change):
    message = model_message(new_message, "bmw_i3", MODEL)
    message.data = change(message.data)
    return message


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: model_message(new_message, "nissan_leaf", MODEL), "other_vehicle_or_version"),
        (lambda: with_data(lambda data: data[:-1]), "lengths_differ"),
        (lambda: with_data(lambda _: np.zeros(MOST_NUMBERS + 1)), "too_large"),
        (lambda: with_data(lambda data: np.append(data[:-1], np.nan)), "not_finite"),
        (lambda: changed(mean=-MODEL.mean), "out_of_range"),
        (lambda: changed(trust=1e9), "out_of_range"),
        (lambda: changed(covariance=-MODEL.covariance), "out_of_range"),
        (lambda: uneven(metres=MODEL.unevenness.metres - 1.0), "out_of_range"),
    ],
)
def test_what_is_no_model_of_this_car_is_refused(make, reason):
    with pytest.raises(BadMessage) as error:
        read_model(make(), CAR)
    assert error.value.reason == reason


hostile = st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from([0.0, -1.0, 1e-308])
PLANS = [
    plan_from_speed_profile(*np.array(points).T)
    for points in (
        ((0, 0, 0), (20, 150, 15), (120, 1650, 15), (140, 1800, 0)),
        ((0, 0, 100, 0), (1e-9, 0, 0, 0), (LONGEST, 99 * LONGEST, 100, 50 * LONGEST)),
    )
]


@given(st.dictionaries(st.integers(0, 10**4), hostile, min_size=1, max_size=4), st.data())
@settings(max_examples=200, deadline=None)
def test_whatever_a_model_says_a_plan_has_a_finite_answer(changes, data):
    """A few numbers of a good model are replaced: it is refused, or good for any plan."""
    message = model_message(new_message, "bmw_i3", MODEL)
    for place, value in changes.items():
        message.data[-place % len(message.data)] = value
    try:
        model = PowerModel(read_model(message, CAR))
    except BadMessage:
        return
    outcome = forecast_plan(data.draw(st.sampled_from(PLANS)), model, Weather(1.2), 60.0)
    columns = outcome.time, outcome.energy, outcome.power, outcome.sigma
    assert np.isfinite(columns).all() and (outcome.sigma >= 0).all()


@pytest.mark.parametrize("name", vehicle_names())
def test_every_car_of_ours_is_possible(name):
    vehicle = load_vehicle(name)
    assert car_is_possible(vehicle_model(vehicle).car)


def test_a_number_that_is_not_finite_is_not_sent():
    with pytest.raises(ValueError, match="finite"):
        changed(mean=MODEL.mean * np.nan)
