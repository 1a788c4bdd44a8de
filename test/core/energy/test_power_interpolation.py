import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.dropout import Bridge
from evpinn_ros.core.energy.power_interpolation import (
    MEMORY,
    MeasuredStep,
    PowerInterpolation,
)
from evpinn_ros.core.energy.quadrature import EnergyIntegral, Step
from evpinn_ros.core.energy.rknn import load_rknn

START = 1_700_000_000_000_000_000
powers = st.floats(-1e5, 1e5)


def stamp(tick):
    """Stamp of a tick of 0.1 s, ns."""
    return START + tick * 100_000_000


def step(begin, end, power, power_next):
    line = Step((end - begin) / 10, power, power_next)
    return MeasuredStep(stamp(begin), stamp(end), line)


def predict(to, ticks, power=lambda tick: 1e3, sigma=1e3):
    return [found for t in ticks for found in to.add_predicted(stamp(t), power(t), sigma)]


def integral(values):
    whole = EnergyIntegral()
    for tick, power in values:
        whole.append(stamp(tick), power)
    return whole


@given(st.lists(powers, min_size=11, max_size=11), powers, st.floats(-1e4, 1e4))
def test_an_error_of_the_prediction_that_is_linear_costs_nothing(truth, offset, slope):
    """Energy and regenerated energy of the step are those of the true power at 10 Hz."""
    course, line = PowerInterpolation(2.0, None), step(0, 10, truth[0], truth[10])
    assert list(course.add_measured(line)) == []
    (found,) = predict(course, range(11), lambda t: truth[t] + offset + slope * t)
    exact = integral(enumerate(truth))
    energy = line.line.energy + found[0].energy
    regenerated = line.line.parts[1] + found[0].regenerated
    assert energy == pytest.approx(exact.energy, abs=1e-3)
    assert regenerated == pytest.approx(exact.regenerated, abs=1e-3)
    assert found[0].gross == pytest.approx(
        exact.drawn + exact.regenerated - sum(line.line.parts), abs=1e-3
    )


@pytest.mark.parametrize("seconds", [0.3, 6.0, 50.0])
def test_an_error_at_the_ends_of_a_dropout_counts_for_as_long_as_it_is_remembered(seconds):
    """Two ends are 1 kW above the prediction: tau tanh(T / 2 tau) seconds each."""
    count = 900
    stamps = [START + round(i / count * seconds * 1e9) for i in range(count + 1)]
    course, line = PowerInterpolation(2.0, None), Step(seconds, 4e3, 4e3)
    nothing = Bridge()
    list(course.add_measured(MeasuredStep(stamps[0], stamps[-1], line, nothing)))
    found = [c for ns in stamps for c in course.add_predicted(ns, 3e3, 1e3)]
    expected = 3e3 * seconds + 2e3 * MEMORY * math.tanh(seconds / 2 / MEMORY)
    assert found[0][0].energy == pytest.approx(expected, rel=1e-3)


def test_the_network_takes_the_midpoints_of_the_course():
    def bump(tick):
        return 1e3 + 9e3 * (tick == 1)

    network, line = load_rknn(), step(0, 4, bump(0), bump(4))
    course, trapezoid = PowerInterpolation(2.0, network), PowerInterpolation(2.0, None)
    for each in (course, trapezoid):
        assert not list(each.add_measured(line))
    (found,), (other,) = (predict(each, range(5), bump) for each in (course, trapezoid))
    expected = network.step(1e3, 1e3, 0.2, 1e4) + network.step(1e3, 1e3, 0.2)
    assert found[0].energy == pytest.approx(float(expected) - 400.0, rel=1e-9)
    assert found[0].energy == pytest.approx(4 / 6 * 9e3 * 0.2, rel=1e-3)  # Simpson's
    assert other[0].energy == pytest.approx(9e3 * 0.1)
    assert other[0].regenerated == found[0].regenerated == 0.0


@pytest.mark.parametrize("network", [None, load_rknn()], ids=["trapezoid", "rknn"])
def test_a_dropout_is_the_prediction_between_its_two_stamps(network):
    """Not up to where the prediction, which lags, was when they came."""
    course, wave = PowerInterpolation(2.0, network), lambda t: 8e3 + 6e3 * math.sin(t / 9)
    counted = Bridge.of_parts(5e4, 1e3)._replace(covered_s=9.7)
    line = step(0, 100, wave(0), wave(100)).line
    list(course.add_measured(MeasuredStep(stamp(0), stamp(100), line, counted)))
    (found,) = predict(course, range(-1, 102), wave)
    exact = integral((t, wave(t)) for t in range(101)).energy
    assert counted.energy + found[0].energy == pytest.approx(exact, rel=1e-3)
    assert found[0].covered_s == 0.0 and found[1] == 0.0


def test_stamps_of_battery_and_prediction_need_not_be_the_same():
    def ramp(tick):
        return 5e3 + 700.0 * tick

    line = Step(1.0, ramp(0.3), ramp(10.3))
    late = MeasuredStep(stamp(0) + 30_000_000, stamp(10) + 30_000_000, line)
    course = PowerInterpolation(2.0, None)
    list(course.add_measured(late))
    (found,) = predict(course, range(12), ramp)
    assert found[0].energy == pytest.approx(0.0, abs=1e-6)
    bent = PowerInterpolation(2.0, None)
    list(bent.add_measured(late))
    (found,) = predict(bent, range(12), lambda t: ramp(t) + 40.0 * (t - 0.3) * (t - 10.3))
    # Of 4000 t (t - 1) W over 1 s, t in s: -4000 / 6.
    assert found[0].energy == pytest.approx(-4000 / 6, rel=0.02)


@pytest.mark.parametrize(
    "ticks",
    [
        range(0),
        range(10),  # never past the step
        range(1, 12),  # begin within it
        [0, 5, 10],  # one inside: no denser than a battery at 2 Hz
        [-15, 8, 9, 10],  # a gap of 2.3 s
    ],
)
def test_where_the_prediction_tells_no_course_the_straight_line_stays(ticks):
    course = PowerInterpolation(2.0, None)
    list(course.add_measured(step(0, 10, 1e3, 1e3)))
    assert predict(course, ticks, lambda t: 1e3 * t * t) == []


def test_every_step_is_told_once_and_in_order():
    course, random = PowerInterpolation(2.0, None), np.random.default_rng(2)
    truth = random.normal(8e3, 2e4, 1001)
    found = []
    for tick in range(1001):
        if tick % 10 == 0 and tick:
            found += course.add_measured(step(tick - 10, tick, truth[tick - 10], truth[tick]))
        if tick >= 3:  # the smoothed prediction lags by 0.3 s
            found += predict(course, [tick - 3], lambda t: 0.9 * truth[t] + 500.0)
    assert len(found) == 99
    coarse = integral((t, truth[t]) for t in range(0, 991, 10)).energy
    fine = integral(enumerate(truth[:991])).energy
    # A tenth of what the straight lines miss is left: the prediction is a tenth too low.
    left = coarse + math.fsum(each[0].energy for each in found) - fine
    assert left == pytest.approx((coarse - fine) / 10, rel=1e-6)
