import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.estimation.reported_loads import (
    DRIVE_STD,
    PRIOR,
    SETTLING,
    ReportedLoads,
)
from evpinn_ros.estimation.worker import InlineWorker
from evpinn_ros.signals.readings import (
    NANOSECONDS,
    AuxiliaryReading,
    BatteryReading,
    SpeedReading,
)


def driven(loads, watts, celsius, seconds):
    """`watts` at each second since the start of the drive."""
    for second in range(seconds):
        loads.add(watts(second), celsius, 1.0)
    return loads


def test_of_a_car_that_reports_none_none_is_expected():
    loads = driven(ReportedLoads(), lambda _: 0.0, -10.0, 1000)
    loads.end_drive()
    assert loads.expected(-10.0) == (0.0, 0.0, 0.0)
    loads.add(1.0, None, 1.0)
    assert loads.expected(-10.0).settled > 1000.0


@given(st.floats(-40.0, 50.0))
def test_the_first_drive_is_expected_as_in_other_cars(celsius):
    loads = ReportedLoads()
    loads.add(1e-9, None, 1e-9)
    loads.end_drive()
    settled, sigma, excess = loads.expected(celsius)
    cold, warm = max(0.0, 20.0 - celsius), max(0.0, celsius - 20.0)
    base, heating, first_heating, cooling, first_cooling = PRIOR
    assert settled == pytest.approx(base + heating * cold + cooling * warm, abs=1.0)
    assert excess == pytest.approx(first_heating * cold + first_cooling * warm, abs=1.0)
    assert sigma >= DRIVE_STD


def test_what_is_learned_of_cold_days_holds_for_cold_days():
    loads = ReportedLoads()
    before = driven(loads, lambda _: 1.0, 20.0, 1).expected(20.0)
    for _ in range(30):
        loads.end_drive()
        driven(loads, lambda t: 250.0 + 20 * (100 + 60 * math.exp(-t / SETTLING)), 0.0, 1800)
    loads.end_drive()
    settled, sigma, excess = loads.expected(0.0)
    first = SETTLING / 1800 * -math.expm1(-1800 / SETTLING)  # mean of exp(-t / SETTLING)
    assert settled + first * excess == pytest.approx(2250.0 + first * 1200.0, rel=0.05)
    assert sigma == pytest.approx(DRIVE_STD, rel=0.15)
    assert loads.expected(20.0).settled == pytest.approx(before.settled, abs=150.0)


def test_in_a_drive_the_present_load_passes_to_what_the_drive_has_shown():
    loads = driven(ReportedLoads(), lambda _: 3000.0, 20.0, 60)
    loads.add(5000.0, 20.0, 1.0)
    soon = loads.expected(20.0)
    assert soon.settled + soon.excess == 5000.0
    later = driven(loads, lambda _: 3000.0, 20.0, 7200).expected(20.0)
    assert soon.settled < later.settled == pytest.approx(3000.0, rel=0.1)
    assert later.sigma < 0.5 * soon.sigma
    loads.end_drive()
    assert loads.expected(20.0).settled < 1000.0, "the next driver may have no need of it"


def test_a_drive_may_be_interrupted():
    whole, halves = ReportedLoads(), ReportedLoads()
    for loads in (whole, halves):
        driven(loads, lambda t: 2000.0 + t, 5.0, 600)
    again = ReportedLoads()
    again.restore(halves.export())
    halves = again
    for loads in (whole, halves):
        driven(loads, lambda t: 1500.0 - t, 4.0, 600)
        loads.end_drive()
        loads.end_drive()
    assert halves.export() == whole.export()
    assert np.linalg.eigvalsh(np.array(whole.export()["covariance"])).min() > 0


def test_the_next_drive_of_a_replay_is_another_wherever_its_stamps_lie(vehicle):
    """As of CSV files, each of which begins at zero."""
    estimator = OnlineEstimator(vehicle, EstimatorSettings(), InlineWorker(lambda: 0.0))
    for k in range(100):
        stamp_ns = k * NANOSECONDS // 2
        list(estimator.add_reading(AuxiliaryReading(stamp_ns, 1500.0, 0.0)))
        list(estimator.add_reading(BatteryReading(stamp_ns, 350.0, -30.0)))
        list(estimator.add_reading(SpeedReading(stamp_ns, 10.0)))
    assert estimator.export()["learner"]["loads"]["drive"][0] > 30.0
    estimator.begin_next_drive()
    assert estimator.export()["learner"]["loads"]["drive"][0] == 0.0
