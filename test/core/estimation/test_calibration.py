import numpy as np
import pytest

from evpinn_ros.core.estimation.calibration import (
    GAUSSIAN_QUANTILE,
    RATIO_RANGE,
    BandCalibration,
    Checked,
)

NOTHING = np.empty(0)


def learn(band: BandCalibration, moving: bool, error: float, sigma: float) -> None:
    """Hold a prediction against its measurement."""
    band.calibrated(NOTHING, NOTHING, [Checked(0, moving, error, sigma)])


def coverage(errors, model_sigma=100.0, last=0.5) -> float:
    """Share of the last part of errors within 1.645 sigma, each judged before it is learned."""
    checked = [Checked(k + 1, True, abs(error), model_sigma) for k, error in enumerate(errors)]
    moving, sigma = np.ones(len(errors), dtype=bool), np.full(len(errors), model_sigma)
    calibrated = BandCalibration().calibrated(moving, sigma, checked)
    inside = np.abs(errors) <= GAUSSIAN_QUANTILE * calibrated
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
        learn(band, True, 1e9, 1.0)
        learn(band, False, 0.0, 1.0)
    assert band.export() == [RATIO_RANGE[1], RATIO_RANGE[0]]


def test_coverage_is_told_of_the_last_minute():
    band = BandCalibration()
    assert np.isnan(band.coverage)
    for error in [1e6] * 300 + [0.0] * 300:
        learn(band, True, error, 100.0)
    assert band.coverage == 0.5
    for _ in range(300):
        learn(band, False, 0.0, 100.0)
    assert band.coverage == 1.0
