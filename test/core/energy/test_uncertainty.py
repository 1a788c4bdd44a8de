import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.uncertainty import (
    CORRELATION_TIME,
    CorrelatedError,
    walked,
)


def test_limits_of_the_model():
    short, long = walked(np.array([0.01, 1e5]), 5.0)
    assert short == pytest.approx(0.01**2, rel=1e-3)  # t^2
    assert long == pytest.approx(2 * 5.0 * 1e5, rel=1e-3)  # 2 tau t


@given(st.lists(st.floats(0.01, 30.0), min_size=1, max_size=50))
def test_step_by_step_equals_the_closed_form(steps):
    error = CorrelatedError()
    for dt in steps:
        error.integrate(250.0, dt)
    expected = 250.0 * math.sqrt(walked(sum(steps), CORRELATION_TIME))
    assert error.sigma == pytest.approx(expected, rel=1e-6)


def test_against_simulated_errors():
    random = np.random.default_rng(1)
    tau, dt, count = CORRELATION_TIME, 0.1, 4000
    keep = math.exp(-dt / tau)
    sigma = np.where(np.arange(200) < 100, 500.0, 1500.0)
    u = random.normal(size=count)
    energy = np.zeros(count)
    error = CorrelatedError()
    for now in sigma:
        after = keep * u + math.sqrt(1 - keep**2) * random.normal(size=count)
        energy += now * (u + after) / 2 * dt
        error.integrate(now, dt)
        u = after
    assert error.sigma == pytest.approx(energy.std(), rel=0.05)


def test_unknown_stays_unknown():
    error = CorrelatedError()
    error.integrate(100.0, 1.0)
    error.integrate(math.nan, 1.0)
    error.integrate(100.0, 1.0)
    assert math.isnan(error.sigma)


def test_start_sigma_adds_as_an_independent_error():
    error, fresh = CorrelatedError(300.0), CorrelatedError()
    for each in (error, fresh):
        each.integrate(100.0, 2.0)
    assert error.sigma == pytest.approx(math.hypot(300.0, fresh.sigma))
