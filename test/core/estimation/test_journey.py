"""The newest samples as journeys: what an interval of the same driving would be."""

import math

import numpy as np
import pytest

from evpinn_ros.core.estimation.journey import MAX_STEP, NOWHERE, SAMPLES_KEPT, Journey, Tail
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.terms import Warmth, equation_of
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import Sample, Samples
from evpinn_ros.core.vehicle.files import load_vehicle

EQUATION = equation_of(load_vehicle("bmw_i3"))
WARM = Warmth(0.0, 0.0)
TENTH = NANOSECONDS // 10


def town(count: int, *, grade: float = 0.01, **others) -> list[Sample]:
    """Samples at 10 Hz of a speed that goes up and down, on a slope."""
    samples = []
    for k in range(count):
        speed = 10.0 + 5.0 * math.sin(k / 40.0)
        acceleration = 5.0 / 4.0 * math.cos(k / 40.0)
        samples.append(Sample(k * TENTH, speed, acceleration, grade, 1.2, 0.0, **others))
    return samples


def tail_of(samples) -> Tail:
    tail = Tail(EQUATION)
    tail.extend(Samples.of(samples))
    return tail


def between(tail: Tail, start_ns: int, end_ns: int) -> Journey:
    """The journey from one stamp to another."""
    return Journey(*(column[0] for column in tail.between(start_ns, np.array([end_ns]), WARM)))


def test_air_comes_from_ahead_in_a_head_wind():
    moments = [Sample(0, 20.0, 0.0, 0.0, 1.2, 0.0, head_wind=wind) for wind in (0.0, 5.0, -5.0)]
    calm, ahead, behind = EQUATION.rows_of(Samples.of(moments), WARM)[:, State.DRAG_AREA_OVER_ETA]
    assert (ahead / calm, behind / calm) == pytest.approx((25**2 / 20**2, 15**2 / 20**2))


def test_its_energy_is_the_integral_of_power():
    samples = town(600)
    whole = between(tail_of(samples), 0, samples[-1].stamp_ns)
    powers = EQUATION.rows_of(Samples.of(samples), WARM) @ EQUATION.mean
    assert whole.seconds == pytest.approx(59.9)
    assert float(whole.row @ EQUATION.mean) == pytest.approx(
        np.trapezoid(powers, dx=0.1), rel=2e-3
    )
    assert whole.row[State.P_AUX] == pytest.approx(59.9)


@pytest.mark.parametrize("middle", [20 * NANOSECONDS, 20 * NANOSECONDS + TENTH // 3])
def test_two_journeys_one_after_the_other_are_one(middle):
    tail = tail_of(town(600))
    end = 50 * NANOSECONDS
    first, second = between(tail, 0, middle), between(tail, middle, end)
    both, whole = first.plus(second), between(tail, 0, end)
    np.testing.assert_allclose(both.row, whole.row, rtol=1e-9, atol=1e-6)
    assert both.seconds == pytest.approx(whole.seconds)
    np.testing.assert_allclose(both.noise, whole.noise, rtol=1e-9)
    assert first.seconds == pytest.approx(middle / NANOSECONDS)


def test_a_road_of_unknown_height_is_unseen_by_its_length():
    seen, unseen = (tail_of(town(100, grade=grade)) for grade in (0.01, 0.0))
    end = 9 * NANOSECONDS
    way = between(unseen, 0, end).row[State.ROLLING]
    assert between(seen, 0, end).unseen == 0.0
    assert between(unseen, 0, end).unseen == pytest.approx(way / 9.80665, rel=0.2)


def test_the_motor_stands_in_for_the_wheels_and_heating_is_counted():
    end = 9 * NANOSECONDS
    motor = between(tail_of(town(100, motor_power=5e3)), 0, end)
    assert motor.row[State.MOTOR_DRIVE] == pytest.approx(45e3)
    assert motor.row[State.MASS_OVER_ETA] == 0.0 and motor.noise[2] > 0.0 == motor.noise[1]
    cold = between(tail_of(town(100, celsius=0.0)), 0, end)
    assert cold.row[State.COLD] == pytest.approx(20.0 * 9.0)


def test_after_a_gap_a_sample_stands_for_no_more_than_some_seconds():
    samples = town(100)
    late = [*samples[:50], *(s._replace(stamp_ns=s.stamp_ns + 10**12) for s in samples[50:])]
    assert between(tail_of(late), 0, 10**13).seconds <= 10.0 + MAX_STEP


@pytest.mark.slow
def test_of_hours_the_newest_are_kept_and_before_any_there_is_nothing():
    assert between(Tail(EQUATION), 0, 10**18).seconds == NOWHERE.seconds
    samples = town(3 * SAMPLES_KEPT)
    tail = Tail(EQUATION)
    for first in range(0, len(samples), 500):
        tail.extend(Samples.of(samples[first : first + 500]))
        between(tail, 0, first * TENTH)  # its sums stay in step
    end = samples[-1].stamp_ns
    kept = between(tail, end - 60 * NANOSECONDS, end)
    fresh = between(tail_of(samples[-700:]), end - 60 * NANOSECONDS, end)
    np.testing.assert_allclose(kept.row, fresh.row, rtol=1e-9, atol=1e-6)


def test_a_tail_that_nobody_asks_holds_no_more_than_it_must():
    """A replay extends it by minutes at once: an hour of them was held."""
    tail, part = Tail(EQUATION), Samples.of(town(SAMPLES_KEPT))
    for number in range(10):
        later_ns = number * SAMPLES_KEPT * TENTH
        tail.extend(part._replace(stamp_ns=part.stamp_ns + later_ns))
    held = sum(samples.size for samples in (tail._samples, *tail._later))
    assert 2 * SAMPLES_KEPT <= held <= 4 * SAMPLES_KEPT
