"""What the trim adds to the car, and when it keeps silent."""

import math

import numpy as np
import pytest

from evpinn_ros.core.estimation.trim import TRIM_SECONDS, Outputs, Trim
from evpinn_ros.core.signals.kinematics import PROFILE
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import Sample, Samples

STEP = 0.1  # s


def outputs(network: Trim, *moments: Sample) -> Outputs:
    """The trim at moments, at its age."""
    rows = network.rows_of(Samples.of(moments))
    return network.outputs(rows, np.full(len(moments), network.age))


def correct(network: Trim, moment: Sample) -> tuple[float, float]:
    """Power that the trim adds at a moment, W, and its 1-sigma, W."""
    now = outputs(network, moment)
    return float(now.power[0]), float(now.sigma[0])


def learn(network: Trim, moment: Sample, residual: float) -> None:
    """Let the trim learn what the car leaves at a moment, W."""
    (row,) = network.rows_of(Samples.of([moment]))
    network.learn(row, outputs(network, moment), residual, STEP)


def sample(second: float, speed: float, acceleration: float) -> Sample:
    profile = (0.1 * math.sin(second), *(0.0,) * (PROFILE - 1))
    return Sample(
        round(second * NANOSECONDS), speed, acceleration, 0.0, 1.17, 0.0, profile=profile
    )


def drive(seconds: float):
    """Speed goes up and down within twenty seconds."""
    for second in np.arange(0.0, seconds, STEP).tolist():
        phase = 2 * math.pi * second / 20.0
        yield sample(second, 15.0 + 5.0 * math.sin(phase), 1.6 * math.cos(phase))


def taught(residual, seconds=120.0) -> Trim:
    """A network after a drive on which physics left so much, W."""
    network = Trim(0)
    for moment in drive(seconds):
        network.advance(STEP)
        learn(network, moment, residual(moment))
    return network


def pattern(moment: Sample) -> float:
    """400 N more than physics has where the car pulls away."""
    return moment.speed * 400.0 * max(0.0, moment.acceleration)


def test_a_pattern_is_learned_and_followed():
    network, errors, left = Trim(0), [], []
    for moment in drive(120.0):
        network.advance(STEP)
        if moment.stamp_ns > 60 * NANOSECONDS:
            errors.append(pattern(moment) - correct(network, moment)[0])
            left.append(pattern(moment))
        learn(network, moment, pattern(moment))
    assert network.share > 0.99
    assert np.std(errors) < 0.35 * np.std(left)


def test_it_fades_once_nothing_is_measured():
    network = taught(lambda moment: 300.0 * moment.speed)
    moment = sample(120.0, 15.0, 0.5)
    before = correct(network, moment)
    network.advance(TRIM_SECONDS)
    later = correct(network, moment)
    assert abs(later[0]) < 0.6 * abs(before[0]) and later[1] > before[1]
    network.advance(20 * TRIM_SECONDS)
    assert abs(correct(network, moment)[0]) < 1.0


def test_rows_together_are_rows_one_by_one():
    network, moments = taught(pattern), list(drive(2.0))
    rows, ages = network.rows_of(Samples.of(moments)), 0.05 * np.arange(len(moments))
    together = network.outputs(rows, ages)
    for index in range(len(moments)):
        single = network.outputs(rows[index : index + 1], ages[index : index + 1])
        for column, alone in zip(together, single, strict=True):
            assert column[index] == pytest.approx(alone[0], rel=1e-9, abs=1e-9)


def test_a_standing_car_gets_nothing():
    assert correct(taught(pattern), sample(0.0, 0.0, 0.0)) == (0.0, 0.0)


@pytest.mark.slow
def test_where_there_is_nothing_to_learn_it_is_silent():
    rng = np.random.default_rng(0)
    network = taught(lambda moment: 2000.0 * rng.standard_normal(), seconds=600.0)
    assert network.share < 0.2
    said = [abs(correct(network, moment)[0]) for moment in drive(20.0)]
    assert np.mean(said) < 0.1 * 2000.0


def test_one_seed_gives_one_network_and_an_outlier_moves_it_little():
    moment = sample(0.0, 15.0, 1.0)

    def after(residual: float, seed: int = 0) -> float:
        network = Trim(seed)
        learn(network, moment, residual)
        network.evidence = 20.0
        return correct(network, moment)[0]

    assert after(3e3) == after(3e3) != after(3e3, seed=1)
    assert 0.0 < after(1e7) < 3 * after(3e4)


@pytest.mark.slow
def test_a_wind_that_holds_is_kept_longer_than_noise_that_does_not():
    rng = np.random.default_rng(1)
    last = 0.0

    def noise(moment: Sample) -> float:
        """Noise of half a second, as errors of speed and battery are."""
        nonlocal last
        last += 0.2 * (300.0 * rng.standard_normal() - last)
        return last * moment.speed

    wind = taught(lambda moment: 300.0 * moment.speed, 300.0).persistence
    short = taught(noise, 300.0).persistence
    assert wind.share_after(1.0) > 0.9
    assert short.share_after(1.0) < 0.3 < 0.5 < short.share_after(0.1)
