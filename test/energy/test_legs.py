"""Legs of a trip and what they are as points."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.energy.dense import dense
from evpinn_ros.energy.plan import Legs, PlanError, legs_of_trip

LEG = st.tuples(st.floats(1.0, 600.0), st.floats(0.5, 40.0) | st.just(0.0), st.floats(-0.1, 0.1))


@given(st.lists(LEG, min_size=1, max_size=30))
def test_points_keep_length_duration_and_climb_of_every_leg(rows):
    duration, speed, slope = np.array(rows).T
    legs = legs_of_trip(duration * speed, duration, slope * duration * speed)
    plan = dense(legs)
    end = np.concatenate(([0.0], np.cumsum(duration)))
    at = np.searchsorted(plan.time, end)
    np.testing.assert_array_equal(plan.time[at], end)
    np.testing.assert_allclose(np.diff(plan.distance[at]), legs.length, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(np.diff(plan.elevation[at]), legs.climb, rtol=1e-6, atol=1e-6)
    standing = legs.length == 0
    assert not plan.speed[at[:-1]][standing].any() and not plan.speed[at[1:]][standing].any()


def test_a_long_leg_between_stops_is_driven_at_its_mean_speed():
    legs = legs_of_trip([0.0, 7500.0, 0.0], [60.0, 300.0, 60.0])
    plan = dense(legs)
    inside = (plan.time > 60.0) & (plan.time < 360.0)
    assert plan.time[inside].tolist() == [70.0, 350.0]
    assert plan.speed[inside] == pytest.approx(25.0)


def test_points_have_the_speeds_that_are_given():
    nan = np.nan
    legs = legs_of_trip([100.0, 300.0], [10.0, 20.0], start_speed=[0.0, nan], end_speed=[nan, 5.0])
    assert dense(legs).speed[[0, -1]].tolist() == [0.0, 5.0]
    assert dense(legs_of_trip([100.0, 300.0], [10.0, 20.0])).speed[1] == pytest.approx(12.0, abs=1)


def test_legs_need_not_be_one_trip():
    """A road network's are checked one by one, and may last longer than a trip."""
    n = 60_000
    same = {name: np.full(n, np.nan) for name in ("limit", "start_speed", "end_speed")}
    edges = Legs(length=np.full(n, 900.0), duration=np.full(n, 60.0), climb=np.zeros(n),
                 height_known=np.zeros(n, bool), **same)  # fmt: skip
    assert len(edges.length) == n
    with pytest.raises(PlanError, match="60000 points are more than 50000"):
        legs_of_trip(edges.length, edges.duration)


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"length": [np.nan, 1.0]}, "length is not finite at leg 0"),
        ({"climb": [0.0, 200.0]}, "climbs more than it is long at leg 1"),
        ({"climb": [0.0]}, "arrays of one length"),
        ({"limit": [50.0, 150.0]}, "limit is not between 0 and 100 m/s at leg 1"),
        ({"end_speed": [-1.0, 1.0]}, "end_speed is not between"),
        ({"length": [], "duration": []}, "arrays of one length"),
        ({"length": [[1.0]], "duration": [[1.0]]}, "arrays of one length"),
        ({"length": 5.0, "duration": 5.0}, "arrays of one length"),
    ],
)
def test_what_are_no_legs_is_refused(given, reason):
    with pytest.raises(PlanError, match=reason):
        legs_of_trip(**{"length": [100.0, 100.0], "duration": [9.0, 9.0]} | given)
