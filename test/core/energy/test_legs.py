"""Legs of a trip and what they are as points."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np

from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import Plan, legs_of_trip, points_of
from evpinn_ros.core.energy.power_model import Weather, vehicle_model
from test.core.energy.cars import CAR

MODEL = vehicle_model(CAR)
LEG = st.tuples(st.floats(1.0, 600.0), st.floats(0.5, 40.0) | st.just(0.0), st.floats(-0.1, 0.1))


@given(st.lists(LEG, min_size=1, max_size=30))
def test_points_keep_length_duration_and_climb_of_every_leg(rows):
    duration, speed, slope = np.array(rows).T
    legs = legs_of_trip(duration * speed, duration, slope * duration * speed)
    plan, without = points_of(legs), points_of(legs_of_trip(legs.length, duration))
    assert plan.level and without.level == (not legs.length.any())
    np.testing.assert_allclose(np.diff(plan.time), legs.duration, rtol=1e-9)
    np.testing.assert_allclose(np.diff(plan.distance), legs.length, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(np.diff(plan.elevation), legs.climb, rtol=1e-6, atol=1e-6)


def test_unevenness_vanishes_as_steps_become_short():
    """Two minutes at alternating speeds: legs of two seconds show all that matters."""
    shares = []
    for seconds in (60.0, 30.0, 5.0, 2.0):
        count = round(120.0 / seconds)
        speed = 15.0 + 0.5 * (np.arange(count) % 2)
        legs = legs_of_trip(speed * seconds, np.full(count, seconds))
        expected, even = (
            forecast_plan(legs, MODEL, Weather(1.2), steady=steady).energy[-1]
            for steady in (False, True)
        )
        shares.append(expected / even - 1.0)
    assert shares[0] > shares[1] > shares[2] > shares[3] == 0.0
    assert shares[0] > 0.1


def test_a_coarse_plan_costs_more_than_even_speed_and_is_less_sure():
    legs = legs_of_trip([9000.0], [600.0])
    speed = 15.0 + np.where(np.arange(10) % 2, 0.5, -0.5)
    minute = legs_of_trip(60.0 * speed, np.full(10, 60.0))
    whole, parts = (forecast_plan(path, MODEL, Weather(1.2)) for path in (legs, minute))
    time = np.arange(0.0, 601.0)
    even = Plan(time, 15.0 * time, np.full(601, 15.0), np.zeros(601), commanded=True)
    fine = forecast_plan(even, MODEL, Weather(1.2))
    assert parts.energy[-1] > 1.05 * fine.energy[-1]
    assert parts.sigma[-1] > fine.sigma[-1] and whole.sigma[-1] > fine.sigma[-1]
