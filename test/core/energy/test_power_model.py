"""A car as plans take it, against the posterior that it is made from."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import plan_from_speed_profile
from evpinn_ros.core.energy.power_model import Weather
from evpinn_ros.core.estimation.states import TABLE, WEIGHTS, State
from evpinn_ros.core.signals.interval import Steps
from evpinn_ros.core.vehicle.physics import GRAVITY
from test.core.energy.cars import CAR, plain, taught

MILD = Weather(1.2, 20.0)


def trip(seed, points=600):
    """Seconds of a drive with stops, hills and hard braking."""
    rng = np.random.default_rng(seed)
    speed = np.maximum(12 + np.cumsum(rng.normal(0, 0.9, points)) * 0.8, 0.0).clip(0, 34)
    climb = speed * np.sin(0.03 * np.sin(np.arange(points) / 60.0 + seed))
    return Steps(np.ones(points), speed, speed**3, speed * np.gradient(speed), climb)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([None, -10.0, 30.0]))
def test_rows_along_a_trip_and_of_the_whole_are_sums_of_those_of_its_steps(seed, celsius):
    motion, model, weather = trip(seed), taught(), Weather(1.2, celsius)
    steps = model.rows(motion, weather)
    along = np.cumsum(steps, axis=0)
    size, way = np.abs(along).max(), np.cumsum(motion.distance)[:, None]

    def check(rows, wanted, metres):
        """Units of the network, of 1 at most, are in single precision, all else is in double."""
        np.testing.assert_allclose(rows[..., :TABLE], wanted[..., :TABLE], atol=1e-12 * size)
        assert (np.abs(rows - wanted)[..., WEIGHTS] <= 1e-6 * metres).all()

    check(model.rows_along(motion, weather), along, way)
    row, energy = model.whole_row(motion, weather)
    check(row, along[-1], way[-1])
    steps[:, State.LOAD] = 0.0
    rounding = 1e-6 * motion.distance * np.abs(model.car.mean[WEIGHTS]).sum()
    assert (np.abs(energy - steps @ model.car.mean) <= rounding + 1e-9 * np.ptp(energy)).all()
    many = Steps(*(np.stack((column, column)) for column in motion[:5]))
    for rows in model.rows_along(many, weather):
        check(rows, along, way)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_the_table_of_the_network_is_as_good_as_the_network(seed):
    motion, model = trip(seed), taught()
    many = Steps(*(column[None] for column in motion[:5]))
    exact = model.rows(motion, MILD).sum(0)
    looked_up = model.summed_rows(many, MILD)[0]
    car = model.car
    gross = float(np.abs(model.rows(motion, MILD) @ car.mean).sum())
    assert looked_up @ car.mean == pytest.approx(exact @ car.mean, abs=1e-3 * gross)


def test_a_payload_is_lifted_through_the_losses_of_the_drivetrain():
    """500 kg up 100 m: m g h is 490 kJ, and the battery gives that over eta."""
    time, model = np.arange(0.0, 401.0), plain()

    def lifted(climb: float) -> float:
        plan = plan_from_speed_profile(time, None, 15.0 + 0.0 * time, climb * time / 400.0)
        cars = model.with_payload(500.0), model
        loaded, empty = (forecast_plan(plan, car, MILD).energy[-1] for car in cars)
        return float(loaded - empty)

    gained = 500.0 * GRAVITY * 100.0
    assert lifted(100.0) - lifted(0.0) == pytest.approx(gained / CAR.priors["eta"].value, rel=1e-3)
