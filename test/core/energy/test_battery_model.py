import math

import numpy as np
import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.battery_model import BatteryModel
from evpinn_ros.core.energy.charge import UNKNOWN, Uncertain
from evpinn_ros.core.energy.forecast import Forecast
from evpinn_ros.core.signals.readings import NANOSECONDS

START = 1_700_000_000_000_000_000
FULL = 62 * 3600.0  # A s
BASE, SLOPE, RESISTANCE = 372.0, 55.0, 0.17  # V at half charge, V, Ohm
CAPACITY = 0.85 * FULL * BASE  # J; the vehicle file is wrong


def voltage(charge, current):
    return BASE + SLOPE * (charge - 0.5) - RESISTANCE * current


def current_for(power, charge):
    """By the other root of P = V I than the code's, in its plain form."""
    level = voltage(charge, 0.0)
    return (level - math.sqrt(level**2 - 4 * RESISTANCE * power)) / (2 * RESISTANCE)


def drive(model, seconds, charge=0.95, begin=0, every=1):
    """A battery with these constants, at 10 Hz over `every`; gives its charge at the end."""
    rows = []
    for tick in range(begin * 10, (begin + seconds) * 10):
        current = 20.0 + 45.0 * math.sin(tick / 37) + 30.0 * math.sin(tick / 300)
        charge -= current * 0.1 / FULL
        if tick % every == 0:
            stamp = START + tick * NANOSECONDS // 10
            rows.append((stamp, voltage(charge, current), -current, charge))
    model.extend(*map(np.array, zip(*rows, strict=True)))
    return charge


def plan(power, seconds):
    """A forecast of constant power, W, without error."""
    time = np.linspace(0.0, seconds, 30)
    return Forecast(time, power * time, np.full(30, power), np.zeros(30))


@pytest.fixture(scope="module")
def learned():
    model = BatteryModel(CAPACITY)
    charge = drive(model, 5000, every=5)
    return model, charge


def test_it_learns_the_charge_and_the_resistance(learned):
    saved = learned[0].saved()
    full, sigma = saved.full_charge.capacity
    assert full == pytest.approx(FULL, rel=0.02) and abs(full - FULL) < 2 * sigma
    resistance, sigma = saved.state[2], math.sqrt(saved.covariance[-1])
    assert resistance == pytest.approx(RESISTANCE, abs=2 * sigma) and sigma < 0.2 * RESISTANCE


@pytest.mark.parametrize("power", [30e3, 5e3, -20e3])
def test_the_end_of_a_plan_is_that_of_the_battery(learned, power):
    """Against the same battery, integrated in steps of a hundredth of a second by Euler."""
    model, charge = learned
    left = charge
    for _ in range(120_000):
        left -= current_for(power, left) * 0.01 / FULL
    end = model.after(plan(power, 1200.0), Uncertain(charge, 0.001), UNKNOWN)
    taken = abs(charge - left)
    assert end.charge.value == pytest.approx(left, abs=0.03 * taken)
    assert abs(end.charge.value - left) < 2 * end.charge.sigma
    assert end.voltage == pytest.approx(voltage(left, current_for(power, left)), abs=1.0)


def test_a_percent_takes_less_energy_of_an_empty_battery_than_of_a_full_one(learned):
    model, _ = learned
    full, empty = (
        charge - model.after(plan(10e3, 600.0), Uncertain(charge, 0.0), UNKNOWN).charge.value
        for charge in (0.9, 0.1 + 0.1)
    )
    assert empty > 1.08 * full


@pytest.mark.slow
def test_without_a_capacity_in_the_vehicle_file_it_waits_for_one():
    model = BatteryModel(math.nan)
    drive(model, 100)
    assert not model.known
    drive(model, 4000, begin=200, every=5)
    assert model.saved().full_charge.capacity.value == pytest.approx(FULL, rel=0.02)
    assert model.known


def test_more_power_than_there_is_and_an_empty_battery_give_finite_ends(learned):
    model, _ = learned
    end = model.after(plan(5e6, 3600.0), Uncertain(0.5, 0.0), UNKNOWN)
    assert end.charge.value == 0.0 and math.isfinite(end.voltage)
    broken = plan(1e4, 60.0)
    endless = Forecast(broken.time, np.full(30, math.nan), broken.power, broken.sigma)
    assert not model.after(endless, Uncertain(0.5, 0.0), UNKNOWN).charge.known


@pytest.mark.parametrize(
    ("start", "ends"), [(0.9, [0.9, 1.0, 0.8]), (0.2, [0.2, -0.1, 0.0])], ids=["full", "empty"]
)
def test_a_full_battery_takes_nothing_back_and_an_empty_one_reaches_no_descent(start, ends):
    full, descent, climb = 1e8, -0.2e8, 0.3e8  # J
    way = {0.9: [0.0, descent, 0.0], 0.2: [0.0, climb, climb + descent]}[start]
    plan_of = Forecast(np.arange(3.0), np.array(way), np.zeros(3), np.zeros(3))
    charge, _ = BatteryModel(math.nan).along(plan_of, Uncertain(start, 0.0), Uncertain(full, 0.0))
    assert charge == pytest.approx(ends)


@pytest.mark.parametrize("wrong", [(1e308, -20.0), (math.nan, -20.0), (370.0, -1e9), (0.0, 0.0)])
def test_readings_of_no_battery_change_nothing(wrong):
    model, sound = BatteryModel(CAPACITY), BatteryModel(CAPACITY)
    for to in (model, sound):
        charge = drive(to, 30)
    model.extend(np.array([START + 29_950_000_000]), *np.array([[*wrong, charge]]).T)
    for to in (model, sound):
        drive(to, 30, charge, begin=30)
    assert model.export() == sound.export()


@pytest.mark.parametrize(
    "wrong",
    [
        {"state": [1e5, 50.0, 0.1]},
        {"covariance": [-1.0, 0, 0, 0, 1, 0, 0, 0, 1]},
        {"covariance": [1.0, 5, 0, 0, 1, 0, 0, 0, 1]},
    ],
)
def test_a_saved_model_of_no_battery_is_refused_and_changes_nothing(wrong):
    model = BatteryModel(CAPACITY)
    drive(model, 100)
    before = model.export()
    with pytest.raises(InputError, match="saved"):
        model.restore({**before, **wrong})
    assert model.export() == before
