"""The linear model of a car against the filter it is made from."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.energy.power_model import Motion, PowerModel
from evpinn_ros.estimation.car_filter import CarFilter
from evpinn_ros.estimation.car_state import State
from evpinn_ros.estimation.forecast_model import linear_power
from evpinn_ros.estimation.reported_loads import ReportedLoads
from evpinn_ros.estimation.weak_form import Warmth, spent
from evpinn_ros.signals.interval import Interval, Steps
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.road import Conditions
from evpinn_ros.vehicle.files import load_vehicle
from evpinn_ros.vehicle.physics import GRAVITY

CAR = load_vehicle("tesla_model_3_lr")
CELSIUS = 5.0
AIR = Conditions(1.2, 0.0, CELSIUS, 0.0, False)
SETTLED = Warmth(0.0, 0.0)
# A plan begins on a road of its own, and what fades within minutes is its drift.
NOT_OF_A_PLAN = [
    State.ROLL_START,
    State.COLD_START,
    State.HOT_START,
    State.AUX,
    State.FORCE,
    State.HEIGHT,
    State.SLOPE,
    State.CLIMB,
]


def trip(seed, points=600):
    """Speed, acceleration and climb of a drive at 1 Hz with stops, hills and hard braking."""
    rng = np.random.default_rng(seed)
    speed = np.maximum(12 + np.cumsum(rng.normal(0, 0.9, points)) * 0.8, 0.0).clip(0, 34)
    grade = 0.03 * np.sin(np.arange(points) / 60.0 + seed)
    return speed, np.gradient(speed), speed * np.sin(grade)


def steps_of(speed, acceleration, climb):
    nothing = np.full(len(speed), np.nan)
    return Steps(
        duration=np.ones(len(speed)),
        distance=speed,
        air=speed**3,
        kinetic=speed * acceleration,
        climb=climb,
        motor_drive=nothing,
        motor_brake=nothing,
    )


def learned(seed=0, minutes=20):
    """A filter that has driven a car with losses that no vehicle file has."""
    found, rng = CarFilter(CAR), np.random.default_rng(seed)
    speed, acceleration, climb = trip(seed, 60 * minutes)
    wheel = 1900.0 * (1.05 * acceleration + GRAVITY * 0.011) * speed + GRAVITY * 1900.0 * climb
    wheel += 0.5 * 1.2 * 0.55 * speed**3
    power = np.where(wheel > 0, wheel / 0.85, 0.7 * wheel) + 700.0 + 400.0 * (speed > 0.3)
    power += 0.02 * wheel**2 / 1e4 + rng.normal(0, 300, len(speed))
    for first in range(0, 60 * minutes, 6):
        part = slice(first, first + 6)
        steps = steps_of(speed[part], acceleration[part], climb[part])
        start, end = first * NANOSECONDS, (first + 6) * NANOSECONDS
        energy = float(power[part].sum())
        found.learn(Interval(start, end, steps, AIR, True, energy, 0.0))
    return found


FILTER = learned()
MODEL = PowerModel(linear_power(FILTER, ReportedLoads(), CAR, CELSIUS))


def exact(motion):
    """Energy, J, and its 1-sigma from all states that a forecast has, by the filter itself."""
    mean, covariance = FILTER.mixture()
    mean = mean.copy()
    mean[NOT_OF_A_PLAN] = 0.0
    found = spent(mean[None], steps_of(*motion), AIR, SETTLED, FILTER.constants)
    gradient = found.gradient[0]
    gradient[NOT_OF_A_PLAN] = 0.0
    return found.energy[0], np.sqrt(gradient @ covariance @ gradient)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_energy_and_sigma_are_those_of_the_filter(seed):
    motion = trip(seed)
    energy, sigma = exact(motion)
    one_second = np.ones((1, len(motion[0])))
    row = Motion(*(column[None] for column in motion), 1.2)
    found = MODEL.energies(row, one_second)[0]

    assert found[0] == pytest.approx(energy, rel=2e-3)
    assert np.sqrt((found[1:] ** 2).sum()) == pytest.approx(sigma, rel=0.02)
