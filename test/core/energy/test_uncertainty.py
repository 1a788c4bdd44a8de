import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.uncertainty import (
    CORRELATION_TIME,
    POWER_MEMORY,
    CorrelatedError,
    sampled,
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


@pytest.mark.parametrize("step", [0.1, 1.0, 5.0, 20.0])
def test_what_lies_between_samples_is_as_uncertain_as_it_says(step):
    """Power forgets itself in 2.5 s; its totals by trapezoids are off by their 1-sigma."""
    random = np.random.default_rng(3)
    fine, steps, count = 200, 40, 300
    keep = math.exp(-step / fine / POWER_MEMORY)
    power = np.empty((count, fine * steps + 1))
    power[:, 0] = random.normal(size=count)
    for column in range(fine * steps):
        noise = random.normal(size=count)
        power[:, column + 1] = keep * power[:, column] + math.sqrt(1 - keep**2) * noise
    samples = power[:, ::fine]
    truth, ours = (
        np.sum(values[:, 1:] + values[:, :-1], axis=1) / 2 * width
        for values, width in ((power, step / fine), (samples, step))
    )
    sigma = np.sqrt(sampled(np.full((count, steps), step), np.diff(samples)).sum(axis=1))
    assert np.sqrt(np.mean(((ours - truth) / sigma) ** 2)) == pytest.approx(1.0, abs=0.12)
