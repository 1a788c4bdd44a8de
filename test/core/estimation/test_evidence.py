"""The data alone: a posterior with its prior taken out."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np

from benchmarks.truth import CarChain
from evpinn_ros.core.estimation.evidence import SIZE, Evidence, evidence
from evpinn_ros.core.estimation.hybrid import HybridLearner
from evpinn_ros.core.estimation.published import evidence_of
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate

LEAF = load_vehicle("nissan_leaf")


@given(st.integers(0, 1000))
def test_the_likelihood_comes_back(seed):
    """A linear measurement of parameters alone, whatever the direction."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((3, SIZE))
    precision, information = rows.T @ rows, rows.T @ rng.standard_normal(3)
    covariance = np.linalg.inv(np.eye(SIZE) + precision)
    likelihood = evidence(covariance @ information, covariance, np.eye(SIZE))
    values, directions = np.linalg.eigh(precision)
    counts = directions[:, values > 0.2]
    np.testing.assert_allclose(counts.T @ likelihood.precision, counts.T @ precision, atol=1e-8)
    np.testing.assert_allclose(
        counts.T @ likelihood.information, counts.T @ information, atol=1e-8
    )


def test_in_other_units_about_another_origin_it_is_the_same_likelihood():
    rng = np.random.default_rng(0)
    rows, mean, scale = (
        rng.standard_normal((SIZE, SIZE)),
        rng.standard_normal(SIZE),
        np.arange(1, 7),
    )
    own = Evidence(rows.T @ rows, rng.standard_normal(SIZE))
    other, places = own.about(mean, scale), rng.standard_normal((3, SIZE))

    def logs(gaussian, where):
        return [x @ gaussian.information - x @ gaussian.precision @ x / 2 for x in where]

    ratios = (
        np.diff(logs(*likelihood))
        for likelihood in ((own, places), (other, (places - mean) / scale))
    )
    np.testing.assert_allclose(*ratios)


def test_the_prior_alone_is_no_evidence():
    likelihood = HybridLearner(LEAF).evidence()
    assert not likelihood.precision.any() and not likelihood.information.any()


def test_a_mean_that_was_pushed_is_no_evidence():
    """A bound moves a mean and leaves its variance: nothing was measured."""
    likelihood = evidence(np.full(SIZE, 0.5), np.eye(SIZE) * 0.95, np.eye(SIZE))
    assert not likelihood.precision.any() and not likelihood.information.any()


def test_a_drive_tells_nothing_of_what_cannot_be_told():
    """eta, 1/mu, mass and C_d scaled together: not even a little, or many cars would add it up."""
    chain = CarChain(LEAF)
    chain.add_readings(simulate(DriveKind.URBAN, LEAF, 240.0, 3).readings)
    driven = chain.car
    sigma = np.array([LEAF.priors[n].std / LEAF.priors[n].value for n in ("eta", "mu", "mass")])
    drag = LEAF.priors["c_d"].std / LEAF.priors["c_d"].value
    untold = np.array([1 / sigma[0], -1 / sigma[1], 1 / sigma[2], 0.0, 1 / drag, 0.0])
    untold /= np.linalg.norm(untold)
    likelihood = evidence_of(driven.state, driven.equation, driven.driven)
    assert np.linalg.norm(likelihood.precision) > 10.0
    assert np.linalg.norm(likelihood.precision @ untold) < 0.01 * np.linalg.norm(
        likelihood.precision
    )
