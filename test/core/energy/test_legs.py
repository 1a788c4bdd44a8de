"""Legs of a trip and what they are as points."""

from dataclasses import replace
from functools import cache

from hypothesis import given
from hypothesis import strategies as st
import numpy as np

from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import Plan, legs_of_trip, points_of
from evpinn_ros.core.energy.power_model import PowerModel, Weather, vehicle_model
from evpinn_ros.core.estimation.states import PHYSICS
from evpinn_ros.core.estimation.unevenness import Path, even_rows
from evpinn_ros.core.vehicle.files import load_vehicle
from test.core.energy.cars import CAR, FEW
from test.core.estimation.test_unevenness import town

MODEL = vehicle_model(CAR)
LEG = st.tuples(st.floats(1.0, 600.0), st.floats(0.5, 40.0) | st.just(0.0), st.floats(-0.1, 0.1))


@given(st.lists(LEG, min_size=1, max_size=30))
def test_points_keep_length_duration_and_climb_of_every_leg(rows):
    duration, speed, slope = np.array(rows).T
    legs = legs_of_trip(duration * speed, duration, slope * duration * speed)
    plan = points_of(legs)
    np.testing.assert_allclose(np.diff(plan.time), legs.duration, rtol=1e-9)
    np.testing.assert_allclose(np.diff(plan.distance), legs.length, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(np.diff(plan.elevation), legs.climb, rtol=1e-6, atol=1e-6)


@FEW
@given(st.lists(LEG, min_size=1, max_size=30))
def test_a_leg_costs_the_same_whatever_is_before_and_after_it_but_for_its_ends(rows):
    """Rows of legs add up: the whole is the sum, and beyond even speed nothing is below zero."""
    duration, speed, slope = np.array(rows).T
    legs = legs_of_trip(duration * speed, duration, slope * duration * speed)
    zero = np.zeros_like(duration)
    path = Path(duration, legs.length, zero, zero, legs.climb, zero + 1.2, zero)
    whole, beyond = MODEL.leg_rows(path, Weather(1.2))
    even = even_rows(MODEL.car.equation, path)
    np.testing.assert_allclose((whole - beyond)[:, PHYSICS], even[:, PHYSICS], atol=1e-6)


def test_unevenness_vanishes_as_steps_become_short():
    """Two minutes in legs of less and less duration: what uneven speed takes goes to zero."""
    shares = []
    for seconds in (60.0, 1.0, 0.1, 0.01):
        count = round(120.0 / seconds)
        duration, zero = np.full(count, seconds), np.zeros(count)
        path = Path(duration, 15.0 * duration, zero, zero, zero, zero + 1.2, zero)
        whole, beyond = MODEL.leg_rows(path, Weather(1.2))
        shares.append(float((beyond @ MODEL.car.mean).sum() / (whole @ MODEL.car.mean).sum()))
    assert shares[0] > 0.05 and shares[3] < 2e-3 * shares[0]
    assert 8.0 < shares[2] / shares[3] < 12.0


@cache
def car_of(name: str, seed: int) -> PowerModel:
    """A car of a vehicle file, with the habits of a driver; of nobody where the seed is 0."""
    model = vehicle_model(load_vehicle(name))
    uneven = model.car.unevenness
    if seed:
        uneven = uneven.after(model.car.equation, model.car.mean, town(seed, 1800.0))
    return PowerModel(replace(model.car, unevenness=uneven))


@FEW
@given(
    st.sampled_from(["bmw_i3", "tesla_model_3_lr", "nissan_leaf", "generic"]),
    st.sampled_from([0, 1, 2]),
    st.floats(3.0, 35.0),
    st.tuples(st.integers(1, 320), st.integers(1, 320)).map(sorted),
)
def test_at_one_mean_speed_longer_legs_never_take_less(name, seed, speed, counts):
    """What uneven speed takes never falls, so that the whole falls by no more than its start."""
    model, length = car_of(name, seed), 16e3

    def energy(count: int, steady: bool) -> float:
        legs = legs_of_trip(np.full(count, length / count), np.full(count, length / count / speed))
        return float(forecast_plan(legs, model, Weather(1.2), steady=steady).energy[-1])

    (long, even), (short, other) = (
        [energy(n, steady) for steady in (False, True)] for n in counts
    )
    assert long - even >= (short - other) * (1.0 - 1e-9) >= 0.0
    assert long >= 0.985 * short


def test_a_coarse_plan_costs_more_than_even_speed_and_is_less_sure():
    legs = legs_of_trip([9000.0], [600.0])
    minute = legs_of_trip(np.full(10, 900.0), np.full(10, 60.0))
    whole, parts = (forecast_plan(path, MODEL, Weather(1.2)) for path in (legs, minute))
    time = np.arange(0.0, 601.0)
    even = Plan(time, 15.0 * time, np.full(601, 15.0), np.zeros(601))
    fine = forecast_plan(even, MODEL, Weather(1.2))
    assert parts.energy[-1] > 1.05 * fine.energy[-1]
    assert parts.sigma[-1] > fine.sigma[-1] and whole.sigma[-1] > fine.sigma[-1]
