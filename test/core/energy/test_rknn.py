import csv
import gzip
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import trapezoid

from evpinn_ros.core.energy.rknn import POWER_LIMIT, Rknn, load_rknn

DATA = Path(__file__).parents[4] / "shared" / "data"
DRIVES = ["tesla_model3/drive_first_757s.csv"] + [
    f"bmw_i3/Trip{name}.csv.gz" for name in ("A01", "A05", "A11", "B02", "B34")
]


@pytest.fixture(scope="module")
def rknn():
    return load_rknn()


def integral(rknn, time, power, middle=None) -> float:
    """Energy of a series, J, every step by itself."""
    return float(rknn.step(power[:-1], power[1:], np.diff(time), middle).sum())


def identity(power, energy=0.0):
    return power


CLASSICAL = Rknn((identity, identity, identity, identity))
powers = st.floats(-2e5, 2e5)


@given(powers, powers, powers, st.floats(0.02, 2.0))
def test_with_identities_it_is_classical_runge_kutta(power, middle, power_next, dt):
    simpson = dt / 6 * (power + 4 * middle + power_next)
    step = CLASSICAL.step(power, power_next, dt, middle)
    assert step == pytest.approx(simpson, rel=1e-12, abs=1e-6)


def test_each_subnetwork_sees_what_equations_26_to_29_give_it():
    seen = []

    def network(*arguments):
        seen.append(arguments)
        return 10.0 * len(seen)

    step = Rknn((network,) * 4).step(100.0, 300.0, 2.0, 220.0)
    assert seen == [(100.0,), (220.0, 10.0), (220.0, 20.0), (300.0, 60.0)]
    assert step == pytest.approx(2 / 6 * (10 + 2 * 20 + 2 * 30 + 40))


@given(powers, st.floats(0.02, 2.0), st.floats(-0.5, 0.5))
def test_single_steps_are_precise_over_the_whole_range(rknn, power, dt, change):
    power_next = power * (1 + change)
    exact = (power + power_next) / 2 * dt
    error = float(rknn.step(power, power_next, dt)) - exact
    assert abs(error) <= 5e-4 * (1e3 + max(abs(power), abs(power_next))) * dt


@pytest.mark.parametrize("dt", [0.02, 0.1, 1.0])
def test_an_hour_at_standstill_accumulates_no_bias(rknn, dt):
    step = rknn.step(1000.0, 1000.0, dt)  # independent of the energy so far
    assert step * 3600 / dt == pytest.approx(3.6e6, rel=3e-4)


@pytest.mark.parametrize("dt", [0.02, 0.1, 1.0])
@pytest.mark.parametrize("noise", [0.0, 20e3])
def test_integral_of_a_drive_whose_net_energy_is_small(rknn, dt, noise):
    time = np.arange(0, 1800 if dt > 0.05 else 360, dt)
    power = 1e3 + 15e3 * np.sin(time / 7) + 4e3 * np.sin(time * 1.3)
    power = power + np.random.default_rng(3).normal(0, 1, len(time)) * noise
    gross_over_net = trapezoid(np.abs(power), time) / trapezoid(power, time)
    assert gross_over_net > 8
    energy = integral(rknn, time, power)
    assert energy == pytest.approx(trapezoid(power, time), rel=1e-3)


@pytest.mark.parametrize("name", DRIVES)
def test_real_drives_within_a_tenth_of_a_percent(rknn, name):
    if not (DATA / name).is_file():
        pytest.skip(f"{DATA / name} is not there")
    opener = gzip.open if name.endswith(".gz") else open
    with opener(DATA / name, "rt") as file:
        rows = csv.reader(file)
        at, of = map(next(rows).index, ("t_s", "power_w"))
        series = [(float(row[at]), float(row[of])) for row in rows if row[of]]
    time, power = np.array(series).T
    energy = integral(rknn, time, power)
    assert energy == pytest.approx(trapezoid(power, time), rel=1e-3)


def test_a_step_with_power_beyond_the_trained_range_is_simpsons_rule(rknn):
    """A car of 760 kW is not counted as one of 500."""
    assert rknn.step(9 * POWER_LIMIT, 9 * POWER_LIMIT, 1.0) == pytest.approx(9 * POWER_LIMIT)
    powers = np.array([[1e4, 2e4], [7.6e5, 0.0], [7.6e5, 1e4]])
    energy = rknn.step(powers[:, 0], powers[:, 1], 0.5, np.array([1.5e4, 3e5, -6e5]))
    assert energy[0] == pytest.approx(float(rknn.step(1e4, 2e4, 0.5, 1.5e4)), rel=1e-9)
    assert energy[1:] == pytest.approx([0.5 / 6 * (7.6e5 + 1.2e6), 0.5 / 6 * (7.7e5 - 2.4e6)])
