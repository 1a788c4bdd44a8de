"""The one equation: rows add up, parts are the whole, and gradients are rows."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.estimation.network import drawn_units, reference_driving, share_of_terms
from evpinn_ros.core.estimation.states import PHYSICS, SIZE, WEIGHTS, State
from evpinn_ros.core.estimation.terms import COUNT, WHOLE, Part, Warmth, coldness, equation_of
from evpinn_ros.core.signals.interval import Steps
from evpinn_ros.core.signals.kinematics import PROFILE
from evpinn_ros.core.signals.road import Conditions
from evpinn_ros.core.signals.sample import Sample, Samples
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.identifiable import prior_identifiable
from evpinn_ros.core.vehicle.physics import GRAVITY
from test.combined import combined_power

CAR = load_vehicle("bmw_i3")
EQUATION = equation_of(CAR)
MILD = Conditions(1.2, 0.0, None, 0.0, False)
COLD = Conditions(1.3, 0.0, -5.0, 0.0, False)
REPORTED = Conditions(1.2, 0.0, 15.0, 800.0, True)
START = Warmth(1.0, 1.0)


def steps_of(seed: int, count: int = 12, *, motor: bool = False, length: float = 1.0) -> Steps:
    """Steps of a drive with stops, hills and braking; `length`: s of each."""
    rng = np.random.default_rng(seed)
    ends = np.maximum(np.cumsum(rng.normal(0, 2.0, count + 1)) + 8.0, 0.0)
    start, end = ends[:-1], ends[1:]
    distance = (start + end) / 2.0 * length
    air = (start + end) * (start**2 + end**2) / 4.0 * length
    climb = distance * rng.normal(0.0, 0.03, count)
    power = rng.normal(0.0, 2e4, count) * length if motor else np.full(count, math.nan)
    motors = np.maximum(power, 0.0), np.maximum(-power, 0.0)
    duration = np.full(count, length)
    return Steps(duration, distance, air, (end**2 - start**2) / 2.0, climb, *motors)


def parts_of(steps, conditions) -> np.ndarray:
    rows, wheels = EQUATION.rows(steps, conditions, START), EQUATION.of_steps(steps, conditions)
    return EQUATION.split(rows, wheels, coldness(conditions.celsius), START.tyres)


@settings(deadline=None, max_examples=50)
@given(
    st.integers(0, 10_000),
    st.sampled_from([MILD, COLD, REPORTED]),
    st.booleans(),
    st.sampled_from([0.1, 1.0, 10.0]),
)
def test_parts_add_up_to_the_whole_for_every_state(seed, conditions, motor, length):
    steps = steps_of(seed, motor=motor, length=length)
    parts = parts_of(steps, conditions)
    whole = EQUATION.rows(steps, conditions, START).sum(0)
    assert parts.shape == (COUNT, SIZE)
    np.testing.assert_allclose(parts[WHOLE].sum(0), whole, rtol=1e-9, atol=1e-6)


unknown = st.just(math.nan)
moments = st.builds(
    Sample,
    st.just(0),
    st.floats(-5.0, 50.0),
    st.floats(-5.0, 5.0),
    st.floats(-0.2, 0.2),
    st.floats(0.9, 1.4),
    st.one_of(st.just(0.0), st.floats(1.0, 5e3)),
    profile=st.just((0.0,) * PROFILE),
    head_wind=st.floats(-20.0, 20.0),
    celsius=st.one_of(unknown, st.floats(-30.0, 45.0)),
    motor_power=st.one_of(unknown, st.floats(-1e5, 2e5)),
    motor_scaled=st.booleans(),
)


@settings(deadline=None)
@given(st.lists(moments, min_size=1, max_size=4))
def test_the_row_of_a_sample_is_that_of_it_among_others(samples):
    rows = EQUATION.rows_of(Samples.of(samples), START)
    alone = [EQUATION.row_of(sample, START) for sample in samples]
    np.testing.assert_allclose(alone, rows, rtol=1e-9, atol=1e-9)


def test_a_head_wind_is_driven_against():
    """20 m/s against 5 m/s is the air of 25 m/s, along the way of 20."""
    still, against = (
        EQUATION.row_of(
            Sample(0, 20.0, 0.0, 0.0, 1.2, 0.0, profile=(0.0,) * PROFILE, head_wind=w), START
        )
        for w in (0.0, 5.0)
    )
    drag = State.DRAG_AREA_OVER_ETA
    assert against[drag] == pytest.approx(still[drag] * (25.0 / 20.0) ** 2)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 11))
def test_rows_of_steps_do_not_depend_on_their_neighbours(seed, cut):
    steps = steps_of(seed)
    whole = EQUATION.rows(steps, COLD, START)
    for part in (slice(cut), slice(cut, None)):
        columns = Steps._make(
            column[part] if isinstance(column, np.ndarray) else column for column in steps
        )
        rows = EQUATION.rows(columns, COLD, START)
        np.testing.assert_allclose(rows, whole[part], rtol=1e-9, atol=1e-9)


def test_an_even_step_costs_the_same_in_one_piece_or_many():
    """Energies are exact whatever the length of a step, for the network too."""

    def even(count: int) -> np.ndarray:
        dt = np.full(count, 60.0 / count)
        nothing, none = np.zeros(count), np.full(count, math.nan)
        columns = dt, 20.0 * dt, 20.0**3 * dt, nothing, 0.2 * dt, none, none
        return EQUATION.rows(Steps(*columns), COLD, START).sum(0)

    np.testing.assert_allclose(even(1), even(60), rtol=1e-9, atol=1e-6)


def test_power_of_the_prior_car_is_that_of_eq_21():
    """Power of a moment, where the beyond-physics states are zero."""
    combined, _ = prior_identifiable(CAR)
    mean = np.zeros(SIZE)
    mean[[*PHYSICS, State.P_AUX]] = EQUATION.mean[[*PHYSICS, State.P_AUX]]
    for speed, acceleration in ((20.0, 0.0), (10.0, 1.0), (15.0, -1.5), (0.0, 0.0)):
        none = np.full(1, math.nan)
        duration, v = np.ones(1), np.full(1, speed)
        steps = Steps(duration, v, v**3, v * acceleration, 0.0 * v, none, none)
        power = float(EQUATION.rows(steps, MILD, Warmth(0.0, 0.0))[0] @ mean)
        expected = combined_power(
            v, np.full(1, acceleration), combined,
            air_density=1.2, rotating_mass_factor=CAR.rotating_mass_factor,
        )  # fmt: skip
        assert power == pytest.approx(float(expected[0]), rel=1e-9)


def test_bundled_units_are_those_that_seed_0_draws():
    network = EQUATION.network
    assert np.array_equal(np.column_stack((network.inner, network.bias)), drawn_units(0))


def test_the_network_has_no_part_in_the_terms_of_eq_21():
    driving = reference_driving()
    speed = driving.speed
    wheels = EQUATION.wheels(
        np.ones_like(speed), speed, speed**3, speed * driving.acceleration,
        speed * driving.slope, CAR.air_density,
    )  # fmt: skip
    rows = EQUATION.moving_rows(wheels, np.ones_like(speed), 0.0, 0.0)
    for beyond in (WEIGHTS, slice(State.FORCE_SQUARED, State.FORCE_SQUARED + 1)):
        power = rows[:, beyond]
        share = share_of_terms(driving, wheels.terms, power)
        size = np.sqrt(driving.seconds @ power**2 / driving.seconds.sum())
        explained = np.sqrt(driving.seconds @ (wheels.terms @ share) ** 2 / driving.seconds.sum())
        assert (explained <= 1e-6 * size + 1e-9).all()
    assert np.linalg.matrix_rank(rows[:, WEIGHTS]) == rows[:, WEIGHTS].shape[1]


def test_a_motor_that_reports_its_torque_stands_in_for_the_wheels():
    steps = steps_of(5, motor=True)
    rows = EQUATION.rows(steps, MILD, START)
    assert not rows[:, PHYSICS].any()
    np.testing.assert_allclose(rows[:, State.MOTOR_DRIVE], steps.motor_drive)
    np.testing.assert_allclose(rows[:, State.MOTOR_BRAKE], -steps.motor_brake)
    assert not rows[:, State.MOTOR_RATIO].any()
    unknown = EQUATION.rows(steps._replace(motor_scaled=False), MILD, START)
    assert unknown[:, State.MOTOR_RATIO].any()  # the ratio of its motor is learned


def test_loads_are_those_of_the_temperature_or_of_the_report():
    steps = steps_of(1)
    mild, cold, reported = (
        EQUATION.rows(steps, conditions, START)[0] for conditions in (MILD, COLD, REPORTED)
    )
    assert mild[State.COLD] == mild[State.HOT] == 0.0 and cold[State.COLD] == 25.0
    assert 0.0 < cold[State.COLD_START] <= 25.0 and cold[State.HOT_START] == 0.0
    assert reported[State.REPORTED] == 800.0
    assert reported[State.COLD] == 0.0 and cold[State.REPORTED] == 0.0
    assert coldness(-5.0) == 2.5 and coldness(None) == coldness(30.0) == 0.0


def test_lifting_a_car_takes_its_weight_times_the_height():
    second, none = np.ones(1), np.full(1, math.nan)
    steps = Steps(second, 20.0 * second, 8000.0 * second, 0.0 * second, second, none, none)
    parts = parts_of(steps, MILD) @ EQUATION.mean
    assert parts[Part.SLOPE] == pytest.approx(GRAVITY * CAR.initial.mass)


def test_a_drivetrain_that_turns_loses_as_much_while_the_car_brakes():
    second, none = np.ones(1), np.full(1, math.nan)
    braking = Steps(
        second, 20.0 * second, 8000.0 * second, -30.0 * second, 0.0 * second, none, none
    )
    parts = parts_of(braking, MILD)
    assert parts[Part.REGAINED, State.REGEN_DELTA] > 0.0
    assert parts[Part.DRIVETRAIN, State.TURNING] == pytest.approx(1.5)
    assert parts[Part.BRAKES, State.TURNING] == parts[Part.REGAINED, State.TURNING] == 0.0


@pytest.mark.parametrize("scaled", [True, False])
def test_braking_is_what_the_motor_reports_in_whichever_step(scaled):
    steps = steps_of(5, motor=True)._replace(motor_scaled=scaled)
    regained = parts_of(steps, MILD)[Part.REGAINED]
    whole = steps.motor_brake.sum()
    assert regained[State.MOTOR_BRAKE] == pytest.approx(whole)
    assert regained[State.MOTOR_DRIVE] == 0.0
    ratio = 0.0 if scaled else EQUATION.mean[State.MOTOR_BRAKE] * whole
    assert regained[State.MOTOR_RATIO] == pytest.approx(ratio)
