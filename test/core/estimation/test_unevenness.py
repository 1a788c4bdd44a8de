"""What uneven speed takes beyond even: nothing at even speed, and learned without a battery."""

import numpy as np
import pytest

from evpinn_ros.core.estimation.states import PHYSICS, State
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.estimation.unevenness import (
    DURATIONS,
    OF_LEGS,
    PRIOR_SHARE,
    Path,
    Unevenness,
    even_rows,
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


def legs(seconds: int, path: Path) -> Path:
    """A plan of this drive with a point every so many seconds."""
    return path.legs((np.arange(len(path.duration)) // seconds).astype(np.int64))


def test_even_legs_keep_way_and_time_and_begin_and_end_standing():
    even = even_rows(EQUATION, legs(60, town(0))).sum(0)
    path = town(0)
    assert even[State.TURNING] > 0.0
    climbed = path.distance.sum() * 9.80665
    mean = EQUATION.mean[PHYSICS]
    assert even[PHYSICS] @ mean > 0.5 * EQUATION.mean[State.ROLLING] * climbed * 0.5
    whole = rows_of(path) @ EQUATION.mean
    assert 0.3 * whole < even @ EQUATION.mean < whole  # even is cheaper, not free


def test_a_drive_that_was_driven_before_is_expected_as_it_was():
    path = town(0)
    cut, driven = legs(60, path), rows_of(path) @ EQUATION.mean
    unevenness = Unevenness.none()
    for _ in range(2):
        unevenness = unevenness.after(EQUATION, EQUATION.mean, path)
    even = even_rows(EQUATION, cut).sum(0) @ EQUATION.mean
    expected = even + unevenness.of_legs(EQUATION, EQUATION.mean, cut).sum(0) @ EQUATION.mean
    assert even < 0.6 * driven
    assert expected == pytest.approx(driven, rel=0.12)  # the prior still counts


@pytest.mark.slow
def test_what_is_expected_of_legs_makes_up_for_even_speed():
    """A dozen drives of one driver teach what another one, cut by the minute, takes."""
    unevenness = Unevenness.none()
    for seed in range(100, 112):
        unevenness = unevenness.after(EQUATION, EQUATION.mean, town(seed))
    errors, before = [], []
    for seed in range(4, 16):
        path = town(seed)
        cut = legs(60, path)
        even = even_rows(EQUATION, cut).sum(0) @ EQUATION.mean
        more = unevenness.of_legs(EQUATION, EQUATION.mean, cut).sum(0) @ EQUATION.mean
        driven = rows_of(path) @ EQUATION.mean
        errors.append((even + more) / driven - 1.0)
        before.append(even / driven - 1.0)
    assert abs(np.mean(errors)) < 0.03
    assert np.mean(before) < -0.3  # even speed alone


def test_it_vanishes_with_the_duration_of_a_leg():
    unevenness = Unevenness.none()
    dt = np.ones(1)
    powers = []
    for seconds in (10.0, 1.0, 0.1):
        step = Path(seconds * dt, 8.0 * seconds * dt, 512.0 * seconds * dt, *(0.0 * dt,) * 2,
                    1.2 * dt, 0.0 * dt)  # fmt: skip
        powers.append(
            float(unevenness.of_legs(EQUATION, EQUATION.mean, step)[0] @ EQUATION.mean) / seconds
        )
    assert powers[0] > 0.0
    assert powers[1:] == pytest.approx([0.1 * powers[0], 0.01 * powers[0]], rel=1e-6)
    assert DURATIONS[0] == 10.0


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
    assert slow.metres[0].any()


def test_chance_counts_less_over_many_legs_and_habit_as_much():
    """Chance decides whether one short leg has a stop; a hundred legs show the habit."""
    size = size_of(np.full(100, 1e5), np.full(100, 1e6)) / np.cumsum(np.full(100, 1e5))
    assert size[0] == pytest.approx(np.sqrt(1.0 + OF_LEGS * 10.0))
    assert size[-1] == pytest.approx(np.sqrt(1.0 + OF_LEGS * 0.1))
    assert not size_of(np.zeros(3), np.full(3, 1e6)).any()
