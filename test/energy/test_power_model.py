"""The reduced model against the filter it is made from."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.energy.power_model import Motion, PowerModel
from evpinn_ros.estimation.parameter_filter import ParameterFilter
from evpinn_ros.estimation.power_filter import DRIFT, FORECAST_STATES, PowerFilter
from evpinn_ros.estimation.window import batch
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.files import load_vehicle

CAR = load_vehicle("tesla_model_3_lr")


def trip(seed, points=600):
    """Samples of a drive at 1 Hz with stops, hills and hard braking."""
    rng = np.random.default_rng(seed)
    speed = np.maximum(12 + np.cumsum(rng.normal(0, 0.9, points)) * 0.8, 0.0).clip(0, 34)
    acceleration = np.gradient(speed)
    grade = 0.03 * np.sin(np.arange(points) / 60.0 + seed)
    return [
        Sample(i * NANOSECONDS, float(v), float(a), float(g), 1.2, 0.0)
        for i, (v, a, g) in enumerate(zip(speed, acceleration, grade, strict=True))
    ]


def motion(samples):
    columns = np.array([(s.speed, s.acceleration, s.grade) for s in samples])
    v, a, g = columns.T
    return Motion(v[None], a[None], (v * np.sin(g))[None], 1.2)


def learned(seed=0, minutes=20):
    """A filter that has driven a car which is not the equations': an efficiency map, say."""
    found = PowerFilter(CAR)
    rng = np.random.default_rng(seed)
    truth = ParameterFilter(CAR, copper_loss=True)
    for sample in trip(seed, 60 * minutes):
        found.advance(sample)
        power = truth.predict(sample).power * 1.1 + 60 * sample.speed * np.sin(sample.speed / 4)
        found.update(sample, float(power + rng.normal(0, 300)), 1.0)
    return found


FILTER = learned()
MODEL = PowerModel(FILTER.linear_power())


def exact(samples):
    """Energy, J, and its 1-sigma from all states that a forecast has, by the filter itself."""
    rows = batch([_observed(s) for s in samples], 0)
    power, gradient = FILTER._model(rows, 0.0)
    power = power - FILTER.mean[DRIFT]
    gradient = gradient[:, FORECAST_STATES].copy()
    gradient[:, -1] = 0.0  # the present drift is apart
    covariance = FILTER.covariance[np.ix_(FORECAST_STATES, FORECAST_STATES)]
    whole = gradient.sum(axis=0)
    return power.sum(), np.sqrt(whole @ covariance @ whole)


def _observed(sample):
    from evpinn_ros.estimation.window import Observation

    return Observation(sample, 0.0, 0.0)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_energy_and_sigma_are_those_of_the_filter(seed):
    samples = trip(seed)
    energy, sigma = exact(samples)
    one_second = np.ones((1, len(samples)))
    found = MODEL.energies(motion(samples), one_second)[0]

    assert found[0] == pytest.approx(energy, rel=2e-3)
    assert np.sqrt((found[1:] ** 2).sum()) == pytest.approx(sigma, rel=0.02)
