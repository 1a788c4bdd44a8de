"""What the trim adds to the car, and when it keeps silent."""

import math

import numpy as np
import pytest

from evpinn_ros.core.estimation.journey import FORCE_NOISE, POWER_NOISE
from evpinn_ros.core.estimation.trim import CORRELATED, FADING, PRIOR, Trim, trim_rows
from evpinn_ros.core.signals.kinematics import PROFILE
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import Sample, Samples

STEP = 0.1  # s


def drive(seconds: float) -> Samples:
    """Speed goes up and down within twenty seconds."""
    moments = []
    for second in np.arange(0.0, seconds, STEP).tolist():
        phase = 2 * math.pi * second / 20.0
        moments.append(sample(second, 15.0 + 5.0 * math.sin(phase), 1.6 * math.cos(phase)))
    return Samples.of(moments)


def sample(second: float, speed: float, acceleration: float) -> Sample:
    profile = (0.1 * math.sin(second), *(0.0,) * (PROFILE - 1))
    return Sample(
        round(second * NANOSECONDS), speed, acceleration, 0.0, 1.17, 0.0, profile=profile
    )


def pattern(samples: Samples) -> np.ndarray:
    """400 N more than physics has where the car pulls away."""
    return samples.speed * 400.0 * np.maximum(0.0, samples.acceleration)


def taught(residuals, samples: Samples) -> Trim:
    """The trim after each of the samples, at which physics left so much, W."""
    return Trim().learned(trim_rows(samples), residuals, np.full(samples.size, STEP))


def at(trim: Trim, moment: Sample, age: float = 0.0) -> tuple[float, float]:
    """Power that the trim adds at a moment, W, and its 1-sigma, W."""
    power, sigma = trim.predict(trim_rows(Samples.of([moment])), np.array([age]))
    of_one, variance = trim.predict_one(moment, age)
    assert (of_one, math.sqrt(variance)) == pytest.approx((power[0], sigma[0]), rel=1e-9)
    return float(power[0]), float(sigma[0])


def test_a_pattern_is_learned_and_followed():
    samples = drive(120.0)
    left = pattern(samples)
    trim = taught(left, samples)
    before = np.arange(samples.size)
    power, _ = trim.predict(trim_rows(samples), np.full(samples.size, STEP), before)
    late = before >= samples.size // 2
    assert np.std((left - power)[late]) < 0.1 * np.std(left[late])


def test_it_fades_once_nothing_is_measured():
    samples = drive(120.0)
    trim, moment = taught(300.0 * samples.speed, samples), sample(120.0, 15.0, 1.6)
    (now, sure), (later, unsure), (late, _) = (
        at(trim, moment, age) for age in (0.0, FADING, 20 * FADING)
    )
    assert now == pytest.approx(4500.0, rel=0.05)
    assert later == pytest.approx(now / math.e) and unsure > sure and abs(late) < 1.0


def test_what_fades_before_a_sample_is_as_what_fades_before_a_prediction():
    samples, moment = drive(20.0), sample(20.0, 12.0, 0.5)
    trim = taught(pattern(samples), samples)
    still = trim.learned(np.zeros((1, trim.weights.shape[1])), np.zeros(1), np.array([7.0]))
    assert at(still, moment) == pytest.approx(at(trim, moment, 7.0), rel=1e-9)


def test_how_samples_are_cut_changes_nothing():
    samples = drive(20.0)
    rows, left, ages = trim_rows(samples), pattern(samples), np.full(samples.size, STEP)
    whole, part = Trim().learned(rows, left, ages), Trim()
    for begin, end in ((0, 1), (1, 90), (90, 90), (90, samples.size)):
        part = part.learned(rows[begin:end], left[begin:end], ages[begin:end]).last()
    for together, cut in zip(whole.last(), part, strict=True):
        assert cut == pytest.approx(together, rel=1e-9)


def test_rows_together_are_rows_one_by_one():
    samples = drive(2.0)
    trim, rows = taught(pattern(samples), samples), trim_rows(samples)
    ages, which = 0.05 * np.arange(samples.size), np.arange(samples.size)
    together = trim.predict(rows, ages, which)
    for index in which:
        of_one = Trim(*(column[index][None] for column in trim))
        alone = of_one.predict(rows[index : index + 1], ages[index : index + 1])
        for column, single in zip(together, alone, strict=True):
            assert column[index] == pytest.approx(single[0], rel=1e-9)


def test_a_standing_car_gets_nothing():
    samples = drive(20.0)
    assert at(taught(pattern(samples), samples), sample(0.0, 0.0, 0.0)) == (0.0, 0.0)


def test_an_outlier_moves_it_little():
    moment = Samples.of([sample(0.0, 15.0, 1.0)])

    def after(residual: float) -> float:
        return at(taught(np.array([residual]), moment), sample(0.0, 15.0, 1.0))[0]

    assert 0.0 < after(1e7) < after(3e4)


def test_without_time_between_samples_it_is_least_squares():
    rng, samples = np.random.default_rng(0), drive(20.0)
    rows = trim_rows(samples)
    left = rows @ [500.0, 100.0, 200.0, 0.0, 0.0, 0.0] + 200.0 * rng.standard_normal(len(rows))
    trim = Trim().learned(rows, left, np.zeros(len(rows))).last()
    noise = CORRELATED * (POWER_NOISE**2 + (FORCE_NOISE * samples.speed) ** 2)
    information = np.diag(1.0 / PRIOR) + (rows.T / noise) @ rows
    expected = np.linalg.solve(information, (rows.T / noise) @ left)
    assert trim.weights[0] == pytest.approx(expected, rel=1e-6)
    assert trim.covariance[0] == pytest.approx(np.linalg.inv(information), rel=1e-6, abs=1e-6)
