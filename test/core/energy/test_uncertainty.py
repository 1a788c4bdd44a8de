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


@given(st.lists(st.floats(0.01, 30.0), min_size=1, max_size=50))
def test_step_by_step_equals_the_closed_form(steps):
    error = CorrelatedError()
    after = error.integrate(np.full(len(steps), 250.0), np.array(steps))
    assert after[-1] == error.sigma**2 or math.isclose(after[-1], error.sigma**2)
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
        error.integrate(np.array([now]), np.array([dt]))
        u = after
    assert error.sigma == pytest.approx(energy.std(), rel=0.05)
