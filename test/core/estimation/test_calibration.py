import numpy as np
import pytest

from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE, RATIO_RANGE, BandCalibration
from evpinn_ros.core.signals.sample import Sample

MOVING = Sample(0, 10.0, 0.0, 0.0, 1.2, 0.0)
STANDING = Sample(0, 0.05, 0.0, 0.0, 1.2, 0.0)


def coverage(errors, sample=MOVING, model_sigma=100.0, last=0.5) -> float:
    """Share of the last part of errors within 1.645 sigma, each judged before it is learned."""
    band, inside = BandCalibration(), []
    for error in errors:
        inside.append(abs(error) <= GAUSSIAN_QUANTILE * band.sigma(sample, model_sigma))
        band.learn(sample, error, model_sigma)
    return float(np.mean(inside[round((1 - last) * len(inside)) :]))


@pytest.mark.parametrize("scale", [20.0, 100.0, 300.0])
@pytest.mark.parametrize("tails", [1.5, 3.0, 30.0])
def test_bands_cover_90_percent_of_heavy_tails(tails, scale):
    """Student's t with so many degrees of freedom; 1.5 has no variance at all."""
    errors = scale * np.random.default_rng(0).standard_t(tails, 8000)
    # 4000 trials: 1-sigma of the share 0.5 %, less by the feedback.
    assert coverage(errors) == pytest.approx(0.9, abs=0.015)


def test_bands_follow_errors_that_grow():
    rng = np.random.default_rng(1)
    errors = np.concatenate((50.0 * rng.standard_normal(4000), 500.0 * rng.standard_normal(4000)))
    # To grow tenfold takes ln 10 / 0.018 = 128 misses, some 3 % of the 4000: they are left out.
    assert coverage(errors, last=0.25) == pytest.approx(0.9, abs=0.02)


def test_the_ratio_stays_in_its_range():
    band = BandCalibration()
    for _ in range(5000):
        band.learn(MOVING, 1e9, 1.0)
        band.learn(STANDING, 0.0, 1.0)
    assert band.export() == [RATIO_RANGE[1], RATIO_RANGE[0]]


def test_coverage_is_told_of_the_last_minute():
    band = BandCalibration()
    assert np.isnan(band.coverage)
    for error in [1e6] * 300 + [0.0] * 300:
        band.learn(MOVING, error, 100.0)
    assert band.coverage == 0.5
    for _ in range(300):
        band.learn(STANDING, 0.0, 100.0)
    assert band.coverage == 1.0
