import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.quadrature import EnergyIntegral, split

SECOND = 1_000_000_000
powers, UNKNOWN = st.floats(-5e5, 5e5), st.just(math.nan)


def integrate(samples, max_gap=2.0):
    integral, rows = EnergyIntegral(max_gap), list(samples)
    stamps = [round(t * SECOND) for t, _ in rows]
    integral.extend(np.array(stamps, np.int64), np.array([power for _, power in rows], float))
    return integral


def test_sign_change_inside_a_step_is_split_exactly():
    # From +3 kW to -1 kW in 2 s: zero is crossed after 1.5 s.
    integral = integrate([(0.0, 3000.0), (2.0, -1000.0)])
    assert integral.total.drawn == pytest.approx(2250.0)
    assert integral.total.regenerated == pytest.approx(250.0)


@given(st.floats(1e-3, 10), powers, powers)
def test_parts_of_a_step_are_positive_and_make_the_whole(dt, power, power_next):
    step = np.array([dt]), np.array([power]), np.array([power_next])
    (drawn,), (regenerated,) = split(*step)
    assert drawn >= 0 and regenerated >= 0
    whole = (power + power_next) / 2 * dt
    assert drawn - regenerated == pytest.approx(whole, rel=1e-9, abs=1e-6)
    backwards = np.ravel(split(step[0], step[2], step[1]))
    assert backwards == pytest.approx([drawn, regenerated])


@given(
    st.lists(
        st.tuples(
            st.sampled_from([0.0, 0.1, 1.0, 1.9, 2.1, 5.0, -3.0]), powers | st.just(math.nan)
        ),
        max_size=60,
    ),
    st.lists(st.integers(1, 9), min_size=60, max_size=60),
)
def test_how_samples_are_cut_changes_nothing(steps, cuts):
    times = np.cumsum([step for step, _ in steps])
    samples = [(float(t), power) for t, (_, power) in zip(times, steps, strict=True)]
    whole, pieces = integrate(samples), EnergyIntegral()
    begin = 0
    for cut in cuts:
        part = samples[begin : begin + cut]
        stamps = np.array([round(t * SECOND) for t, _ in part], np.int64)
        pieces.extend(stamps, np.array([power for _, power in part], float))
        begin += cut
    assert pieces.total == whole.total


def test_a_gap_is_counted_and_not_integrated():
    integral = integrate([(0.0, 1000.0), (1.0, 1000.0), (11.0, 9000.0), (12.0, 1000.0)])
    assert integral.total.drawn == pytest.approx(1000.0 + 5000.0)
    assert (integral.total.gaps, integral.total.gap_s) == (1, 10.0)


def test_what_is_late_repeated_or_not_finite_is_dropped_and_counted():
    samples = [(0.0, 1000.0), (1.0, 1000.0), (1.0, 7.0), (0.5, 7.0), (1.5, math.nan)]
    integral = integrate([*samples, (1.6, math.inf), (2.0, 1000.0)])
    assert integral.total.drawn == pytest.approx(2000.0)
    assert (integral.total.out_of_order, integral.total.not_finite, integral.dropped) == (2, 2, 4)
    assert integral.total.gaps == 0


@given(st.lists(st.tuples(st.floats(0, 100), powers), max_size=30))
def test_an_integral_goes_on_from_the_saved_totals(samples):
    integral = integrate(samples)
    copy = EnergyIntegral(saved=integral.total)
    assert copy.total == integral.total
    copy.extend(np.array([10**15]), np.array([1000.0]))
    assert copy.total == integral.total
