"""Energy of an interval: its gradient, and the strong form (eq. 19) integrated."""

import math

from hypothesis import assume, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.estimation.car_state import SIZE, State, prior_of
from evpinn_ros.estimation.weak_form import (
    Constants,
    Warmth,
    motor_energy,
    spent,
    unit_step,
    wheels_at,
)
from evpinn_ros.signals.interval import Steps
from evpinn_ros.signals.road import Conditions
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.files import load_vehicle
from evpinn_ros.vehicle.linear_power import FADE_SPEED
from evpinn_ros.vehicle.parameters import Parameters
from evpinn_ros.vehicle.physics import RegenForm, battery_power

MODEL_3 = load_vehicle("tesla_model_3_lr")
CAR = Constants.of(MODEL_3)
PRIOR = prior_of(MODEL_3)
WARM = Warmth(0.0, 0.0)
TRUTH = Parameters(eta=0.85, mu=0.78, mass=1960.0, c_rr=0.0105, c_d=0.235, p_aux=1250.0)
UNITS = {State.P_AUX: 1e2, State.NO_LOAD: 1e2, State.COPPER: 1e2, State.AUX: 1e2}

surroundings = st.builds(
    Conditions,
    air_density=st.floats(1.0, 1.4),
    head_wind=st.just(0.0),
    celsius=st.one_of(st.none(), st.floats(-20.0, 40.0)),
    load=st.floats(0.0, 3000.0),
    load_known=st.booleans(),
)


def true_power(speed, acceleration, air_density, grade):
    """Power of the true car by eq. 21, W."""
    return battery_power(
        speed,
        acceleration * CAR.rotating_mass_factor,
        TRUTH,
        area=CAR.frontal_area,
        air_density=air_density,
        form=RegenForm.WHEEL_POWER,
        beta=MODEL_3.beta,
        grade=grade,
    )


def drawn_steps(seed: int, motor: bool) -> Steps:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 7))
    speed = rng.uniform(0.0, 35.0, count)
    duration = rng.uniform(1.0, 2.0, count)
    motors = rng.uniform(0.0, 4e4, (2, count)) if motor else np.full((2, count), math.nan)
    kinetic, climb = speed * rng.normal(0.0, 1.0, count), speed * rng.normal(0.0, 0.02, count)
    return Steps(
        duration, duration * speed, duration * speed**3, kinetic, duration * climb, *motors
    )


def drawn_state(seed: int) -> np.ndarray:
    """Two hypotheses about the prior, the fast states included."""
    rng = np.random.default_rng(seed)
    spread = np.where(PRIOR.std > 0, PRIOR.std, 0.0)
    spread[[State.AUX, State.FORCE, State.CLIMB]] = 300.0, 0.004, 0.5
    return PRIOR.mean + rng.normal(0.0, 1.0, (2, SIZE)) * spread


def far_from_bends(mean: np.ndarray, steps: Steps, around: Conditions, warmth: Warmth) -> bool:
    """Where the wheels turn from driving to braking the energy has no gradient."""
    wheels = wheels_at(mean, steps, around, warmth, CAR)
    return float(np.abs(wheels.total).min()) > 100.0


@pytest.mark.slow
@pytest.mark.parametrize("motor", [False, True])
@given(st.integers(0, 10_000), surroundings, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_the_gradient_is_that_of_finite_differences(motor, seed, around, tyres, cabin):
    """All but that of copper loss by the force itself, which is taken as it is."""
    steps, mean, warmth = drawn_steps(seed, motor), drawn_state(seed), Warmth(tyres, cabin)
    assume(far_from_bends(mean, steps, around, warmth))
    mean[:, State.COPPER] = 0.0
    functions = [
        lambda x: (lambda f: (f.energy, f.gradient))(spent(x, steps, around, warmth, CAR))
    ]
    functions += [
        lambda x, part=part: motor_energy(x, steps, around, warmth, CAR)[part] for part in (0, 1)
    ]
    for function in functions:
        energy, gradient = function(mean)
        for index in range(SIZE):
            step = 1e-5 * UNITS.get(State(index), 1.0)
            ends = []
            for sign in (-1, 1):
                moved = mean.copy()
                moved[:, index] += sign * step
                ends.append(function(moved)[0])
            difference = (ends[1] - ends[0]) / (2 * step)
            rounding = 1e-10 * (np.abs(energy).max() + 1e4) / step
            np.testing.assert_allclose(difference, gradient[:, index], rtol=1e-4, atol=rounding)


def state_of(parameters: Parameters) -> np.ndarray:
    """The states of a car that obeys eq. 19 to the letter."""
    mean = np.zeros((1, SIZE))
    mean[0, : State.NO_LOAD] = (
        math.log(parameters.eta),
        math.log(parameters.mu),
        math.log(parameters.mass),
        parameters.c_rr / CAR.c_rr,
        math.log(parameters.c_d),
        parameters.p_aux,
    )
    return mean


@pytest.mark.parametrize(
    ("start", "acceleration", "slope"),
    [(5.0, 1.2, 0.0), (28.0, -1.5, 0.0), (20.0, 0.0, 0.05), (20.0, 0.0, -0.05), (12.0, 0.5, 0.02)],
)
def test_energy_is_the_integral_of_the_strong_form(intervals, start, acceleration, slope):
    """Ten seconds of one acceleration on one slope; recuperation above a walking pace."""
    time = np.arange(0, 7.0, 0.01)
    speed = start + acceleration * time
    assert speed[:601].min() > FADE_SPEED
    (interval,) = intervals(speed[:701], height=lambda x: x * math.sin(slope))
    power = true_power(speed[:601], acceleration, 1.17, slope)
    expected = float(np.sum(power[1:] + power[:-1]) / 2 * 0.01)
    found = spent(state_of(TRUTH), interval.steps, interval.conditions, WARM, CAR)
    assert found.energy[0] == pytest.approx(expected, rel=1e-3)


@given(
    st.floats(-20.0, 40.0).filter(lambda v: abs(v) > 0.5),
    st.floats(-3.0, 3.0),
    st.floats(-0.1, 0.1),
    st.floats(0.0, 3000.0),
)
def test_the_energy_of_a_unit_step_is_power(speed, acceleration, grade, load):
    sample = Sample(0, speed, acceleration, grade, 1.2, load)
    found = spent(state_of(TRUTH), *unit_step(sample), WARM, CAR)
    expected = float(true_power(speed, acceleration, 1.2, grade)) + load
    wheel = float(found.wheel_drive[0] - found.wheel_brake[0])
    if wheel < 0 and abs(speed) < FADE_SPEED:
        assert expected - 1e-6 <= found.energy[0] <= TRUTH.p_aux + load, "friction takes some"
    else:
        # The road is as long as it is steep: cos(grade) of rolling resistance, 0.5 % at 0.1 rad.
        slack = 0.006 * TRUTH.c_rr * TRUTH.mass * 9.81 * abs(speed) / TRUTH.eta
        assert found.energy[0] == pytest.approx(expected, abs=slack + 1.0)


def test_a_motor_that_tells_its_torque_stands_in_for_the_wheels(conditions):
    """eta of the battery's way to the shaft is eta times what the gears lose (TORQUE)."""
    mean = state_of(TRUTH)
    mean[0, State.TORQUE], mean[0, State.GENERATOR] = 0.02, math.log(0.9)
    one = np.array([1.0])
    steps = Steps(one, 20 * one, 8000 * one, 0 * one, 0 * one, 2e4 * one, 5e3 * one)
    energy = spent(mean, steps, conditions(), WARM, CAR).energy[0]
    assert energy == pytest.approx(2e4 / 0.85 / math.exp(0.02) - 0.9 * 5e3 + 1250.0)
