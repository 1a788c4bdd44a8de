import math

from hypothesis import example, given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from evpinn_ros.core.energy.path_plan import (
    BEND,
    COMFORT_ACCELERATION,
    COMFORT_LATERAL,
    SLOWEST,
    plan_from_path,
)
from evpinn_ros.core.energy.plan import Plan, PlanError, plan_from_speed_profile

LINE = np.array([0.0, 100.0, 200.0, 300.0])
ZERO = np.zeros(4)


def test_path_with_stamps():
    plan = plan_from_path(LINE, ZERO, ZERO + 5, np.array([50.0, 60.0, 70.0, 80.0]))
    assert plan.time == pytest.approx([0, 10, 20, 30])
    assert plan.distance == pytest.approx(LINE)
    assert plan.speed == pytest.approx([10.0] * 4)
    assert plan.elevation == pytest.approx([5.0] * 4)


def test_length_is_measured_along_the_slope():
    plan = plan_from_path(
        np.array([0.0, 3.0]), np.array([0.0, 0.0]), np.array([0.0, 4.0]), np.array([0.0, 1.0])
    )
    assert plan.distance[-1] == pytest.approx(5.0)


@given(
    st.lists(
        st.tuples(st.floats(0.01, 100.0), st.integers(0, 4000).map(lambda v: v / 100)),
        min_size=1,
        max_size=30,
    )
)
def test_speed_along_a_path_is_the_slope_of_a_monotone_cubic(legs):
    """Against scipy's: legs of some seconds at some speed, some of them at rest.

    Speeds are whole cm/s: a point that smaller changes take from a line counts as on it.
    """
    seconds, speeds = np.array(legs).T
    time, x = (np.concatenate(([0.0], np.cumsum(v))) for v in (seconds, seconds * speeds))
    plan = plan_from_path(x, 0.0 * x, 0.0 * x, time)
    knots = np.concatenate(([True], np.diff(speeds) != 0.0, [True]))  # the others say nothing
    cubic = PchipInterpolator(time[knots], x[knots]).derivative()
    at = np.searchsorted(plan.time, time[knots] - 1e-9)
    slopes = np.clip(cubic(time[knots]), 0.0, 100.0)
    np.testing.assert_allclose(plan.speed[at], slopes, atol=1e-6)


def test_a_point_given_twice_with_other_rounding_is_one():
    x, y = np.array([0.0, 1e5, 1e5, 1e5 + 20.0]), np.array([0.0, 0.0, 1e-12, 0.0])
    plan = plan_from_path(x, y, 0.0 * x, np.array([0.0, 2e3, 2e3, 2e3 + 1.0]))
    assert len(plan.time) == 3 and np.isfinite(plan.speed).all()


@pytest.mark.parametrize("stamps", [None, np.zeros(4), np.full(4, 1.7e9)])
def test_without_usable_stamps_it_drives_the_nominal_speed(stamps):
    plan = plan_from_path(LINE, ZERO, ZERO, stamps, nominal_speed=10.0)
    assert set(LINE) <= set(plan.distance)
    speed = np.interp([0, 50, 100, 200, 250, 300], plan.distance, plan.speed)
    assert speed == pytest.approx([0, 10, 10, 10, 10, 0])
    assert plan.time[-1] == pytest.approx(10 + 20 + 10)


def test_speed_profile_counts_from_its_first_point():
    plan = plan_from_speed_profile([5.0, 6.0], [100.0, 110.0], [10.0, 10.0])
    assert plan.time == pytest.approx([0, 1])
    assert plan.distance == pytest.approx([0, 10])
    assert plan.elevation == pytest.approx([0, 0])


def test_without_distance_it_is_as_the_speeds_make_it():
    plan = plan_from_speed_profile([0.0, 10.0, 20.0], None, [0.0, 20.0, 10.0])
    assert plan.distance.tolist() == [0.0, 100.0, 250.0]


@pytest.mark.parametrize(
    ("x", "stamps", "reason"),
    [
        (LINE, [0.0, 10.0, 5.0, 20.0], "time goes back at point 3"),
        (LINE, [0.0, 10.0, 10.0, 20.0], "faster than 100 m/s at point 3"),
        (LINE, [0.0, 10.0, np.nan, 20.0], "stamps is not finite at point 3"),
        ([0.0, np.nan, 1.0, 2.0], None, "x is not finite at point 2"),
        ([], [], "needs at least two points"),
        (np.zeros(4), None, "neither length nor duration"),
        (LINE, [0.0, 10.0], "arrays differ in shape"),
        (np.zeros(1_000_000), None, "1000000 points are more than 50000"),
        ([0.0, 10.0, 20e3, 21e3], None, "jumps farther than 10 km at point 3"),
        ([0.0, 1e200, -1e200, 0.0], LINE, "jumps farther than 120960 km at point 2"),
    ],
)
def test_a_path_that_is_no_trip(x, stamps, reason):
    x = np.asarray(x)
    with pytest.raises(PlanError, match=reason) as error:
        plan_from_path(x, np.zeros(len(x)), np.zeros(len(x)), stamps)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("time", "distance", "speed", "elevation", "reason"),
    [
        ([0.0, 0.0], [0.0, 1.0], [1.0, 1.0], None, "time does not rise at point 2"),
        ([0.0, 1.0], [1.0, 0.0], [1.0, 1.0], None, "distance goes back"),
        ([0.0, 1.0], [0.0, 101.0], [1.0, 1.0], None, "faster than"),
        ([0.0, 1.0], [0.0, 1.0], [1.0, 101.0], None, "speed is above 100 m/s at point 2"),
        ([0.0, 1.0], [0.0, 1.0], [-1.0, 1.0], None, "speed is negative at point 1"),
        ([0.0, 1.0], [0.0, 1.0], [1.0, np.inf], None, "speed is not finite at point 2"),
        ([0.0, 1.0], [0.0, 1.0], [1.0, 1.0], [0.0, 2.0], "climbs more than it travels"),
        ([0.0, 1.0], None, [1.0], None, "differ in shape"),
        ([0.0, 10.0], [0.0, 200.0], [72.0, 72.0], None, "make 720 m, its distance is 200 m"),
    ],
)
def test_a_profile_that_is_no_trip(time, distance, speed, elevation, reason):
    with pytest.raises(PlanError, match=reason):
        plan_from_speed_profile(time, distance, speed, elevation)


def test_in_a_batch_the_error_names_the_trip_and_the_point():
    time = np.array([[0.0, 1.0, 2.0], [0.0, 1.0, 1.0]])
    zero = np.zeros((2, 3))
    with pytest.raises(PlanError, match="time does not rise at point 3 of trip 2"):
        Plan(time, zero, zero, zero)


def around_a_corner(angle, leg=300.0):
    """A path that turns by an angle, rad, half way."""
    turned = leg * np.array([1 + np.cos(angle), np.sin(angle)])
    return np.array([0.0, leg, turned[0]]), np.array([0.0, 0.0, turned[1]])


@example(0.287009838009571, 5.0, 0.0)  # two points of the path are apart by rounding
@given(st.floats(0.0, math.pi), st.floats(5.0, 35.0), st.just(0.0) | st.floats(0.0, 50.0))
def test_a_nominal_profile_is_comfortable(angle, nominal, start):
    x, y = around_a_corner(angle)
    plan = plan_from_path(x, y, np.zeros(3), nominal_speed=nominal, start_speed=start)
    assert (plan.speed <= max(nominal, start) + 1e-9).all()
    stops = math.sqrt(2.0 * COMFORT_ACCELERATION * plan.distance[-1])
    assert plan.speed[0] == pytest.approx(min(start, stops), rel=1e-6) and plan.speed[-1] == 0.0
    there = plan.distance >= abs(nominal**2 - start**2) / (2 * COMFORT_ACCELERATION)
    assert (plan.speed[there] <= nominal + 1e-9).all()
    gained = np.abs(np.diff(plan.speed**2)) / (2 * np.diff(plan.distance))
    assert gained.max() <= COMFORT_ACCELERATION * (1 + 1e-6)
    assert plan.speed[1:-1].min() > 0


def test_bends_are_taken_slowly_and_straights_are_not():
    speeds = []
    for angle in (0.0, 0.5, math.pi / 2, math.pi):
        x, y = around_a_corner(angle)
        plan = plan_from_path(x, y, np.zeros(3), nominal_speed=20.0)
        speeds.append(np.interp(300.0, plan.distance, plan.speed))
    assert speeds[0] == pytest.approx(20.0)
    assert speeds[1] == pytest.approx(
        math.sqrt(COMFORT_LATERAL * BEND / 2 / math.sin(0.25)), rel=1e-6
    )
    assert speeds[2] == pytest.approx(math.sqrt(COMFORT_LATERAL * BEND / math.sqrt(2)), rel=1e-6)
    assert speeds[3] == pytest.approx(SLOWEST)


def test_a_circle_is_driven_at_its_lateral_limit():
    angle = np.linspace(0, 2 * np.pi, 400)
    plan = plan_from_path(80 * np.cos(angle), 80 * np.sin(angle), 0 * angle, nominal_speed=30.0)
    middle = (plan.distance > 100) & (plan.distance < 400)
    assert plan.speed[middle] == pytest.approx(math.sqrt(COMFORT_LATERAL * 80), rel=0.01)


def test_the_noise_of_a_map_is_no_bend():
    x = np.arange(0.0, 1000.0, 1.0)
    y = np.random.default_rng(1).normal(0, 0.02, x.size)
    plan = plan_from_path(x, y, 0 * x, nominal_speed=15.0)
    assert np.median(plan.speed) == pytest.approx(15.0)


def test_a_plan_driven_twice_as_fast_stands_as_long_as_before():
    time, distance = np.array([0.0, 10.0, 20.0, 30.0]), np.array([0.0, 100.0, 100.0, 200.0])
    plan = Plan(time, distance, np.array([10.0, 0.0, 0.0, 10.0]), 0.0 * time).quicker(2.0)
    assert plan.time.tolist() == [0.0, 5.0, 15.0, 20.0]
    assert plan.speed.tolist() == [20.0, 0.0, 0.0, 20.0]
