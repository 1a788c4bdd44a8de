"""The data alone: a posterior with its prior taken out."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.estimation.evidence import SIZE, evidence
from evpinn_ros.estimation.published_filter import PublishedFilter
from evpinn_ros.estimation.worker import InlineWorker
from evpinn_ros.simulation.drive import DriveKind
from evpinn_ros.simulation.simulate import simulate
from evpinn_ros.vehicle.files import load_vehicle

LEAF = load_vehicle("nissan_leaf")
STATES = SIZE + 2


def unmoved(states=STATES):
    return np.column_stack((np.eye(states), np.zeros(states)))


@given(st.integers(0, 1000))
def test_the_likelihood_comes_back(seed):
    """Of a linear measurement of parameters alone, whatever the direction."""
    rng = np.random.default_rng(seed)
    rows = np.column_stack((rng.standard_normal((3, SIZE)), np.zeros((3, 2))))
    precision = rows.T @ rows
    information = rows.T @ rng.standard_normal(3)
    covariance = np.linalg.inv(np.eye(STATES) + precision)
    found = evidence(covariance @ information, covariance, unmoved())
    values, directions = np.linalg.eigh(precision[:SIZE, :SIZE])
    counts = directions[:, values > 0.2]
    np.testing.assert_allclose(
        counts.T @ found.precision, counts.T @ precision[:SIZE, :SIZE], atol=1e-8
    )
    np.testing.assert_allclose(
        counts.T @ found.information, counts.T @ information[:SIZE], atol=1e-8
    )


def test_the_prior_alone_is_no_evidence():
    found = PublishedFilter(LEAF).evidence()
    assert not found.precision.any() and not found.information.any()


def test_a_held_state_or_a_mean_that_was_pushed_is_no_evidence():
    """A bound moves a mean and leaves its variance: nothing was measured."""
    found = evidence(np.full(STATES, 0.5), np.eye(STATES) * 0.95, unmoved())
    assert not found.precision.any() and not found.information.any()


@pytest.fixture(scope="module")
def driven() -> PublishedFilter:
    drive = simulate(DriveKind.URBAN, LEAF, 240.0, 3)
    estimator = OnlineEstimator(LEAF, EstimatorSettings(), InlineWorker(lambda: 0.0))
    for reading in drive.readings:
        for _ in estimator.push(reading):
            pass
    filter_ = PublishedFilter(LEAF)
    filter_.restore(estimator.export()["learner"]["parameter_filter"])
    return filter_


def test_a_drive_tells_nothing_of_what_cannot_be_told(driven):
    """eta, 1/mu, mass and C_d scaled together: not even a little, or many cars would add it up."""
    sigma = np.array([LEAF.priors[n].std / LEAF.priors[n].value for n in ("eta", "mu", "mass")])
    drag = LEAF.priors["c_d"].std / LEAF.priors["c_d"].value
    untold = np.array([1 / sigma[0], -1 / sigma[1], 1 / sigma[2], 0.0, 1 / drag, 0.0])
    untold /= np.linalg.norm(untold)
    found = driven.evidence()
    assert np.linalg.norm(found.precision) > 10.0
    assert np.linalg.norm(found.precision @ untold) < 1e-6 * np.linalg.norm(found.precision)
    assert abs(found.information @ untold) < 1e-6 * np.linalg.norm(found.information)


def test_prior_and_evidence_are_what_was_believed(driven):
    """Joined with the vehicle file again, the evidence gives what was published."""
    found, told = driven.evidence(), driven.published()
    covariance = np.linalg.inv(np.eye(SIZE) + found.precision)
    std = np.sqrt(np.diag(covariance))
    value = covariance @ found.information
    for index, name in enumerate(("eta", "mu", "mass", "c_rr", "c_d", "p_aux")):
        deviation = getattr(told.deviation(), name)
        share = getattr(told.prior_share(), name)
        assert std[index] == pytest.approx(np.sqrt(share), abs=0.06), name
        assert value[index] == pytest.approx(deviation, abs=0.2), name
