"""The data alone: a posterior with its prior taken out."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from benchmarks.truth import CarChain
from evpinn_ros.estimation.car_state import State
from evpinn_ros.estimation.evidence import SIZE, evidence
from evpinn_ros.estimation.pinn import LearnedCar, PinnLearner
from evpinn_ros.estimation.published import evidence_of, published
from evpinn_ros.simulation.drive import DriveKind
from evpinn_ros.simulation.simulate import simulate
from evpinn_ros.vehicle.files import load_vehicle
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES

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
    found = PinnLearner(LEAF).evidence()
    assert not found.precision.any() and not found.information.any()


def test_a_held_state_or_a_mean_that_was_pushed_is_no_evidence():
    """A bound moves a mean and leaves its variance: nothing was measured."""
    found = evidence(np.full(STATES, 0.5), np.eye(STATES) * 0.95, unmoved())
    assert not found.precision.any() and not found.information.any()


@pytest.fixture(scope="module")
def driven() -> LearnedCar:
    drive = simulate(DriveKind.URBAN, LEAF, 240.0, 3)
    chain = CarChain(LEAF)
    for reading in drive.readings:
        chain.add_reading(reading)
    return chain.car


def test_a_drive_tells_nothing_of_what_cannot_be_told(driven):
    """eta, 1/mu, mass and C_d scaled together: not even a little, or many cars would add it up."""
    sigma = np.array([LEAF.priors[n].std / LEAF.priors[n].value for n in ("eta", "mu", "mass")])
    drag = LEAF.priors["c_d"].std / LEAF.priors["c_d"].value
    untold = np.array([1 / sigma[0], -1 / sigma[1], 1 / sigma[2], 0.0, 1 / drag, 0.0])
    untold /= np.linalg.norm(untold)
    found = evidence_of(driven.filter, driven.sums)
    assert np.linalg.norm(found.precision) > 10.0
    assert np.linalg.norm(found.precision @ untold) < 1e-6 * np.linalg.norm(found.precision)
    assert abs(found.information @ untold) < 1e-6 * np.linalg.norm(found.information)


def test_prior_and_evidence_are_what_was_believed(driven):
    """Joined with the vehicle file again, the evidence gives what was published."""
    found, live = (of(driven.filter, driven.sums) for of in (evidence_of, published))
    covariance = np.linalg.inv(np.eye(SIZE) + found.precision)
    std, value = np.sqrt(np.diag(covariance)), covariance @ found.information
    for index, name in enumerate(PARAMETER_NAMES):
        prior, now = LEAF.priors[name], float(live.now.mean[index])
        spread = float(np.sqrt(live.now.covariance[index, index]))
        if name == "p_aux":
            away, sigma = now - prior.value, prior.std
        else:
            before = np.log(prior.value)
            if name == "c_rr":  # of this drive, with its tyres: only what is the car's is evidence
                lasting = driven.filter.mixture().covariance[State.C_RR, State.C_RR]
                now, spread = np.log(now), float(np.sqrt(lasting))
                before = np.log(float(live.prior.mean[index]))
            away, sigma = now - before, prior.std / prior.value
        assert std[index] == pytest.approx(spread / sigma, abs=0.06), name
        assert value[index] == pytest.approx(away / sigma, abs=0.2), name
