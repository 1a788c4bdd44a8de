from dataclasses import replace
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.estimation.parameter_filter import P_AUX, SLOPE, STATES, ParameterFilter
from evpinn_ros.estimation.power_filter import (
    DRIFT,
    HILL_RANGE,
    HILL_STD,
    REPORTED,
    UNITS,
    PowerFilter,
)
from evpinn_ros.estimation.window import Observation, batch
from evpinn_ros.signals.kinematics import COURSE
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading
from evpinn_ros.signals.sample import MeasuredSample, Sample
from evpinn_ros.signals.stream import SampleStream, StreamSettings
from evpinn_ros.vehicle.linear_power import FEATURES
from evpinn_ros.vehicle.parameters import Parameters

TRUTH = Parameters(eta=0.85, mu=0.78, mass=1960.0, c_rr=0.0105, c_d=0.235, p_aux=1250.0)
RATE = 5  # Hz of `synthetic`


def learn(found, drive, added=lambda _: 0.0) -> list[float]:
    """Teach a drive with something added to its power; the errors made before each sample."""
    errors = []
    for sample, power in zip(drive.samples, drive.powers, strict=True):
        found.advance(sample)
        errors.append(found.update(sample, power + added(sample), 1 / RATE))
    return errors


def rms(errors) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


samples = st.builds(
    Sample,
    st.just(0),
    st.floats(-5.0, 45.0),
    st.floats(-4.0, 4.0),
    st.floats(-0.1, 0.1),
    st.just(1.17),
    st.floats(0.0, 5000.0),
    st.tuples(*[st.floats(-1.0, 1.0)] * COURSE),
)


@given(samples)
def test_before_anything_the_network_says_zero(vehicle, sample):
    physics = ParameterFilter(vehicle, copper_loss=True).predict(sample)
    assert PowerFilter(vehicle).predict(sample).power == pytest.approx(physics.power)


@given(samples, st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_the_gradient_by_the_states(vehicle, sample, seed):
    """All is linear, physics and network: a finite difference of any size is exact."""
    found = PowerFilter(vehicle)
    rng = np.random.default_rng(seed)
    found.mean = found.mean + 0.1 * rng.standard_normal(found.mean.size)
    before = found.predict(sample)
    for index in rng.integers(0, found.mean.size, 20):
        found.mean[index] += 7.0
        change = (found.predict(sample).power - before.power) / 7.0
        assert change == pytest.approx(before.gradient[index], rel=1e-6, abs=1e-5)
        found.mean[index] -= 7.0


def test_many_samples_at_once_are_as_each_alone(vehicle, synthetic):
    found = PowerFilter(vehicle)
    drive = synthetic(TRUTH, seconds=60.0)
    learn(found, drive)
    course = tuple(0.01 * k for k in range(COURSE))
    rows = [replace(sample, course=course) for sample in drive.samples[::20]] + [drive.samples[7]]
    data = batch([Observation(sample, 0.0, found.slope) for sample in rows], rows[-1].stamp_ns)
    power, gradient = found.powers(data)
    assert power == pytest.approx([found.predict(sample).power for sample in rows])
    assert gradient.shape == (len(rows), SLOPE)


def test_a_loss_that_no_equation_knows_is_learned(vehicle, synthetic):
    """A drivetrain that wastes 4 kW at about 8 m/s alone."""
    drive = synthetic(TRUTH, seconds=300.0, noise=0.2, hills=0.0)

    def waste(sample):
        return 4000.0 * math.exp(-(((sample.speed - 8.0) / 2.5) ** 2))

    late = slice(200 * RATE, None)
    physics = rms(learn(ParameterFilter(vehicle, copper_loss=True), drive, waste)[late])
    assert rms(learn(PowerFilter(vehicle), drive, waste)[late]) < 0.7 * physics


def test_a_car_of_the_equations_is_predicted_no_worse(vehicle, synthetic):
    """The network has nothing to win here, and must not lose."""
    drive = synthetic(TRUTH, seconds=300.0)
    physics = rms(learn(ParameterFilter(vehicle, copper_loss=True), drive)[60 * RATE :])
    assert rms(learn(PowerFilter(vehicle), drive)[60 * RATE :]) < 1.05 * physics


def test_a_lag_between_speed_and_power_is_learned(vehicle, synthetic):
    """Power answers to the acceleration of 0.1 s before its sample."""
    drive = synthetic(TRUTH, seconds=300.0, noise=0.2, hills=0.0)
    rng = np.random.default_rng(0)
    told = [
        replace(sample, course=(0.0, 0.0, 0.0, *rng.normal(0.0, 0.5, COURSE - 3)))
        for sample in drive.samples
    ]
    drive = replace(drive, samples=told)
    mass = 1960.0 * 1.03 / 0.85

    def late_answer(sample):
        return mass * sample.speed * sample.course[3] * 0.3

    late = slice(200 * RATE, None)
    physics = rms(learn(ParameterFilter(vehicle, copper_loss=True), drive, late_answer)[late])
    found = PowerFilter(vehicle)
    assert rms(learn(found, drive, late_answer)[late]) < 0.5 * physics
    weights = found.mean[len(STATES) + UNITS : REPORTED]
    assert weights[3] == pytest.approx(0.3 * mass, rel=0.15)
    assert np.abs(np.delete(weights, 3)).max() < 0.05 * mass


def test_reported_loads_that_are_not_drawn(vehicle):
    """A heater that is said to draw 4 kW, on and off, and draws none of it."""
    found = PowerFilter(vehicle)
    for k in range(600 * RATE):
        heater = 4000.0 if k // (50 * RATE) % 2 else 0.0
        sample = Sample(k * NANOSECONDS // RATE, 0.0, 0.0, 0.0, 1.17, heater)
        found.advance(sample)
        found.update(sample, 900.0, 1 / RATE)
    assert found.mean[REPORTED] == pytest.approx(-1.0, abs=0.05)
    hot, cold = (found.predict(replace(sample, known_auxiliary=w)).power for w in (4000.0, 0.0))
    assert hot == pytest.approx(900.0, abs=100.0) and cold == pytest.approx(900.0, abs=100.0)
    found.forget_time()  # another drive: its sensors are believed again
    assert found.mean[REPORTED] == 0.0


def test_the_car_keeps_its_own_mean_of_auxiliary_power(vehicle):
    """Drives at 700 W and 1500 W in turn: the next begins between them, whatever the last was."""
    found = PowerFilter(vehicle)
    begins = []
    for drive in range(8):
        found.forget_time()
        begins.append(found.mean[P_AUX] + found.mean[DRIFT])
        for k in range(120 * RATE):
            stamp = (drive * 86400 + k / RATE) * NANOSECONDS
            sample = Sample(round(stamp), 0.0, 0.0, 0.0, 1.17, 0.0)
            found.advance(sample)
            found.update(sample, 1500.0 if drive % 2 else 700.0, 1 / RATE)
    assert all(900.0 < begin < 1300.0 for begin in begins[2:])
    assert begins[0] == vehicle.priors["p_aux"].value


@pytest.mark.parametrize(("hills", "low", "high"), [(0.0, 0.0, 0.8), (4.0, 1.3, 3.0)])
def test_how_hilly_the_roads_are_is_learned(vehicle, synthetic, hills, low, high):
    """Slopes of 0 and of 0.024 rad, 1-sigma."""
    found = PowerFilter(vehicle)
    for seed in range(5):
        found.forget_time()
        learn(found, synthetic(TRUTH, seconds=900.0, seed=seed, noise=0.5, hills=hills))
        assert HILL_RANGE[0] <= found.hilliness <= HILL_RANGE[1]
        assert found.covariance[SLOPE, SLOPE] <= found.hilliness**2 * (1 + 1e-9)
    assert low * HILL_STD < found.hilliness < high * HILL_STD


def test_a_round_trip_is_exact_and_what_does_not_fit_is_refused(vehicle, synthetic):
    found = PowerFilter(vehicle)
    learn(found, synthetic(TRUTH, hills=3.0))
    saved = found.export()
    assert saved["hilliness"] != HILL_STD
    other = PowerFilter(vehicle)
    other.restore(saved)
    assert other.export() == saved
    fresh = PowerFilter(vehicle)
    before = fresh.export()
    for wrong in (
        {"hilliness": math.nan},
        {"hilliness": 1.0},
        {"loads": {**saved["loads"], "mean": [1.0, math.nan, 1.0, 1.0, 1.0]}},
        {"loads": {**saved["loads"], "drive": [1.0] * 6}},
        {"loads": {**saved["loads"], "drive": [-1.0] * 7}},
        {"loads": {**saved["loads"], "covariance": (-np.eye(5)).tolist()}},
        {"mean": saved["mean"][: len(STATES)]},
        {"mean": [1e6] * len(saved["mean"])},
    ):
        with pytest.raises(ValueError, match="saved"):
            fresh.restore({**saved, **wrong})
        assert fresh.export() == before


def test_forecasts_expect_the_loads_that_were_reported(vehicle, synthetic):
    found = PowerFilter(vehicle)
    before = found.linear_power()
    drive = synthetic(TRUTH)
    for sample, power in zip(drive.samples, drive.powers, strict=True):
        with_load = replace(sample, known_auxiliary=2000.0)
        found.advance(with_load)
        found.update(with_load, power + 2000.0, 1 / RATE)
    now = found.linear_power()
    constant, drift = FEATURES.index("constant"), FEATURES.index("present_drift")
    assert before.mean[constant] == vehicle.initial.p_aux and before.mean[drift] == 0.0
    assert now.mean[constant] + now.mean[drift] == pytest.approx(TRUTH.p_aux + 2000.0, rel=0.15)
    assert TRUTH.p_aux < now.mean[constant], "some of it is of this drive"
    found.forget_time()
    found.end_drive()
    later, frost = found.linear_power(20.0), found.linear_power(-10.0)
    assert later.mean[constant] < now.mean[constant], "not every drive is like this one"
    assert later.mean[drift] == 0.0, "on a mild day no cabin is to be heated at first"
    assert frost.mean[constant] > later.mean[constant] + 1000.0
    assert frost.mean[drift] > 1000.0
    assert np.linalg.norm(later.directions[:, constant]) > np.linalg.norm(
        before.directions[:, constant]
    )


def test_the_lag_between_speed_and_power_is_estimated(vehicle, drive):
    """The same drive told twice, the battery 0.2 s later in the second."""
    lags = []
    for late_ns in (0, NANOSECONDS // 5):
        found = PowerFilter(vehicle)
        stream = SampleStream(StreamSettings(), vehicle.air_density)
        for reading in drive(3, 200.0).readings:
            if isinstance(reading, BatteryReading):
                reading = replace(reading, stamp_ns=reading.stamp_ns + late_ns)
            for event in stream.push(reading):
                if isinstance(event, MeasuredSample):
                    found.advance(event.sample)
                    found.update(event.sample, event.power, 0.1)
        lag, lag_std = found.lag
        lags.append(lag)
        assert 0.0 < lag_std < 0.05
    assert abs(lags[0]) < 0.1
    assert lags[1] - lags[0] == pytest.approx(0.2, abs=0.05)
