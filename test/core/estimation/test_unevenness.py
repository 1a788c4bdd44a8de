"""What uneven speed takes beyond even: nothing at even speed, and learned without a battery."""

from dataclasses import replace

import numpy as np
import pytest

from evpinn_ros.core.estimation.even import Path, even_course
from evpinn_ros.core.estimation.states import PHYSICS, State
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.estimation.unevenness import (
    OF_LEGS,
    PRIOR_SHARE,
    UNEVEN_STATES,
    Runs,
    Unevenness,
    runs_along,
    size_of,
)
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import SAMPLE_RATE, DriveKind, drive_speed

EQUATION = equation_of(load_vehicle("bmw_i3"))


def path_of(speed: np.ndarray) -> Path:
    """Steps of a flat road from speed once a second."""
    start, end = speed[:-1], speed[1:]
    dt = np.ones(len(start))
    air = (start + end) * (start**2 + end**2) / 4.0
    kinetic = (end**2 - start**2) / 2.0
    return Path(dt, (start + end) / 2.0, air, kinetic, 0.0 * dt, 1.2 * dt, 0.0 * dt)


def town(seed: int, seconds: float = 900.0) -> Path:
    speed = drive_speed(DriveKind.URBAN, seconds, np.random.default_rng(seed))
    return path_of(np.maximum(speed[::SAMPLE_RATE], 0.0))


def rows_of(path: Path) -> np.ndarray:
    wheels = EQUATION.wheels(*path[:5], path.density)
    return EQUATION.moving_rows(wheels, path.duration, 0.0, 0.0).sum(0)


def energies(unevenness: Unevenness, seconds: int, path: Path) -> tuple[float, float]:
    """Energy of a drive as legs of so many s: at even speed, and what is expected beyond, J."""
    course = even_course(path.legs((np.arange(len(path.duration)) // seconds).astype(np.int64)))
    beyond = unevenness.rows(EQUATION, runs_along(course)) @ EQUATION.mean[UNEVEN_STATES]
    return float(rows_of(course.steps) @ EQUATION.mean), float(beyond.sum())


def test_even_legs_keep_way_and_time_and_begin_and_end_standing():
    path = town(0)
    steps = even_course(path.legs((np.arange(len(path.duration)) // 60).astype(np.int64))).steps
    for column in ("duration", "distance", "climb"):
        assert getattr(steps, column).sum() == pytest.approx(getattr(path, column).sum())
    assert steps.kinetic.sum() == pytest.approx(0.0, abs=1e-9)
    even, whole = rows_of(steps), rows_of(path) @ EQUATION.mean
    assert even[PHYSICS] @ EQUATION.mean[PHYSICS] > 0.0
    assert 0.3 * whole < even @ EQUATION.mean < whole  # even is cheaper, not free


def test_where_the_road_goes_on_the_last_speed_is_kept():
    speed = np.repeat([0.0, 10.0, 20.0], 100)
    legs = path_of(speed).legs(np.arange(299) // 100)
    ended, onward = (even_course(legs, onward=on).steps for on in (False, True))
    assert ended.kinetic.sum() == pytest.approx(0.0)
    last = legs.distance[-1] / legs.duration[-1]
    assert onward.kinetic.sum() == pytest.approx(last**2 / 2.0)


def test_a_drive_that_was_driven_before_is_expected_as_it_was():
    path = town(0, 1800.0)
    driven = rows_of(path) @ EQUATION.mean
    unevenness = Unevenness.none()
    for _ in range(5):
        unevenness = unevenness.after(EQUATION, EQUATION.mean, path)
    for seconds in (10, 30, 60, 200, 600):
        even, beyond = energies(unevenness, seconds, path)
        assert even < 0.9 * driven
        assert even + beyond == pytest.approx(driven, rel=0.12)  # the prior still counts


@pytest.mark.slow
def test_what_is_expected_of_legs_makes_up_for_even_speed():
    """A dozen drives of one driver teach what another one, cut by the minute, takes."""
    unevenness = Unevenness.none()
    for seed in range(100, 112):
        unevenness = unevenness.after(EQUATION, EQUATION.mean, town(seed))
    errors, before = [], []
    for seed in range(4, 16):
        path = town(seed)
        even, more = energies(unevenness, 60, path)
        driven = rows_of(path) @ EQUATION.mean
        errors.append((even + more) / driven - 1.0)
        before.append(even / driven - 1.0)
    assert abs(np.mean(errors)) < 0.03
    assert np.mean(before) < -0.25  # even speed alone


def test_it_begins_at_two_seconds_and_grows_with_the_duration_of_a_run():
    duration = np.array([1.0, 2.0, 4.0, 6.0, 10.0])
    runs = Runs(duration, 8.0 * duration, 1.2 + 0.0 * duration)
    energy = Unevenness.none().rows(EQUATION, runs) @ EQUATION.mean[UNEVEN_STATES] / duration
    assert energy[:2].tolist() == [0.0, 0.0] and energy[-1] > 0.0
    assert energy[2:4] == pytest.approx([0.25 * energy[-1], 0.5 * energy[-1]])


def test_what_is_learned_in_town_says_nothing_of_motorways():
    """A sedan that is uneven in town and even on motorways: each has factors of its own."""
    town_alone = Unevenness.none().after(EQUATION, EQUATION.mean, town(0))
    both = town_alone.after(EQUATION, EQUATION.mean, path_of(np.full(5001, 30.0)))
    in_town, on_motorways = (uneven.factors(EQUATION)[[0, -1]] for uneven in (town_alone, both))
    assert np.abs(in_town[0] - 1.0).max() > 0.05
    assert in_town[1, -1] == 1.0 and on_motorways[1, -1] < 0.05  # one run of 83 minutes
    assert on_motorways[0] == pytest.approx(in_town[0], abs=0.05)


def test_a_vehicle_in_no_traffic_drives_evenly_until_it_has_shown_otherwise():
    robot = replace(EQUATION.vehicle, nominal_speed=1.0)
    assert not robot.in_traffic
    equation, fresh = equation_of(robot), Unevenness.none()
    assert not fresh.factors(equation).any()
    assert (fresh.factors(EQUATION) == 1.0).all()
    assert fresh.after(equation, EQUATION.mean, town(0)).factors(equation).max() > 0.1


@pytest.mark.slow
def test_a_driver_of_habit_narrows_the_scatter_and_a_moody_one_widens_it():
    rng = np.random.default_rng(0)
    calm = moody = Unevenness.none()
    same = town(0)
    for _ in range(25):
        calm = calm.after(EQUATION, EQUATION.mean, same)
        mood = town(int(rng.integers(100)), 300.0)
        speed = np.where(rng.uniform() < 0.5, 8.0, 1.0) * np.ones(400)
        other = mood if rng.uniform() < 0.5 else path_of(speed)
        moody = moody.after(EQUATION, EQUATION.mean, other)
    assert calm.share < PRIOR_SHARE and moody.share > calm.share


def test_driving_of_150_km_ago_counts_a_third():
    slow = Unevenness.none().after(EQUATION, EQUATION.mean, path_of(np.full(2000, 2.0)))
    later = slow.after(EQUATION, EQUATION.mean, path_of(np.full(5001, 30.0)))  # of other nodes
    assert later.metres[0] == pytest.approx(slow.metres[0] / np.e)
    assert slow.metres[0] > 0.0


def test_a_car_of_another_size_learns_the_same_factors():
    """The sums are metres: a scooter taken for a car forecasts as a scooter."""
    double = EQUATION.mean.copy()
    double[[State.DRAG_AREA_OVER_ETA, State.MASS_OVER_ETA, State.ROLLING]] *= 2.0
    light, heavy = (
        Unevenness.none().after(EQUATION, mean, town(0)) for mean in (EQUATION.mean, double)
    )
    assert heavy.factors(EQUATION) == pytest.approx(light.factors(EQUATION), rel=0.05)


def test_chance_counts_less_over_many_legs_and_habit_as_much():
    """Chance decides whether one short leg has a stop; a hundred legs show the habit."""
    energy, count = 1e5, np.array([1.0, 100.0])
    size = size_of(count * energy, count * energy * 1e6) / (count * energy)
    assert size == pytest.approx(np.sqrt(1.0 + OF_LEGS * np.array([10.0, 0.1])))
    assert size_of(0.0, 0.0) == 0.0
