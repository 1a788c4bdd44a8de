import math

from hypothesis import given
from hypothesis import strategies as st
import pytest

from evpinn_ros.core.energy.quadrature import EnergyIntegral, Step

SECOND = 1_000_000_000
powers = st.floats(-5e5, 5e5)


def integrate(samples, max_gap=2.0):
    integral = EnergyIntegral(max_gap)
    for t, power in samples:
        integral.append(round(t * SECOND), power)
    return integral


def test_sign_change_inside_a_step_is_split_exactly():
    # From +3 kW to -1 kW in 2 s: zero is crossed after 1.5 s.
    integral = integrate([(0.0, 3000.0), (2.0, -1000.0)])
    assert integral.drawn == pytest.approx(2250.0)
    assert integral.regenerated == pytest.approx(250.0)
    assert integral.energy == pytest.approx(2000.0)


@given(st.floats(1e-3, 10), powers, powers)
def test_parts_of_a_step_are_positive_and_make_the_whole(dt, power, power_next):
    step = Step(dt, power, power_next)
    drawn, regenerated = step.parts
    assert drawn >= 0 and regenerated >= 0
    assert drawn - regenerated == pytest.approx(step.energy, rel=1e-9, abs=1e-6)
    backwards = Step(dt, power_next, power).parts
    assert backwards == pytest.approx((drawn, regenerated))


def test_a_gap_is_counted_and_not_integrated():
    integral = integrate([(0.0, 1000.0), (1.0, 1000.0), (11.0, 9000.0), (12.0, 1000.0)])
    assert integral.energy == pytest.approx(1000.0 + 5000.0)
    assert (integral.gaps, integral.gap_s) == (1, 10.0)


def test_what_is_late_repeated_or_not_finite_is_dropped_and_counted():
    samples = [(0.0, 1000.0), (1.0, 1000.0), (1.0, 7.0), (0.5, 7.0), (1.5, math.nan)]
    integral = integrate([*samples, (1.6, math.inf), (2.0, 1000.0)])
    assert integral.energy == pytest.approx(2000.0)
    assert (integral.out_of_order, integral.not_finite, integral.dropped) == (2, 2, 4)
    assert integral.gaps == 0


@given(st.lists(st.tuples(st.floats(0, 100), powers), max_size=30))
def test_an_integral_goes_on_from_the_saved_totals(samples):
    integral = integrate(samples)
    copy = EnergyIntegral(saved=integral.saved())
    assert copy.saved() == integral.saved()
    assert copy.append(10**15, 1000.0) is None
    assert copy.gaps == integral.gaps
