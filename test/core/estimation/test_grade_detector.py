"""A grade whose sign contradicts the energy of hills is named, and a right one never."""

from dataclasses import replace

import numpy as np
import pytest

from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.terms import Warmth, equation_of
from evpinn_ros.core.signals.detector import GRADE_SIGN
from evpinn_ros.core.signals.sign_detectors import ALIKE, GradeDetector


class Hills:
    """A car on a country road whose hills a sensor tells `sign` times."""

    def __init__(self, vehicle, intervals) -> None:
        self.equation = equation_of(vehicle)
        self.car = LearnedCar.new(self.equation)
        self._intervals, self._rng, self._begin = intervals, np.random.default_rng(0), 0

    def drive(self, seconds: int, sign: float) -> bool:
        """Whether the sign of grade was suspected at any time."""
        suspected = False
        time = self._begin + np.arange(0.0, seconds, 0.01)
        speed = 15.0 + 3.0 * np.sin(time / 20)
        for interval in self._intervals(speed, height=self._height, begin_ns=self._begin * 10**9):
            rows = self.equation.rows(interval.steps, interval.conditions, Warmth(0.0, 0.0))
            drawn = float(rows.sum(0) @ self.equation.mean)
            steps = interval.steps._replace(
                climb=sign * interval.steps.climb + 0.02 * self._rng.standard_normal(6)
            )
            energy = drawn + 5e3 * self._rng.standard_normal()
            measured = replace(interval, energy=energy, sampling_variance=0.0, steps=steps)
            self.car = self.car.after([measured])
            suspected |= self.car.grade.detected is not None
        self._begin += seconds
        return suspected

    @staticmethod
    def _height(odometer):
        return 6.0 * np.sin(odometer / 220.0) + 4.0 * np.sin(odometer / 600.0)


@pytest.fixture
def hills(vehicle, intervals) -> Hills:
    return Hills(vehicle, intervals)


@pytest.mark.parametrize("sign", [1.0, 0.0])
def test_a_right_grade_and_none_are_never_suspected(hills, sign):
    assert not hills.drive(1200, sign)


@pytest.mark.slow
def test_a_flipped_grade_is_found_within_ten_kilometres_and_mended(hills):
    hills.drive(660, -1.0)
    assert hills.car.grade.detected == GRADE_SIGN
    hills.drive(2400, 1.0)
    assert not hills.car.grade.detected


@pytest.mark.parametrize(
    ("fall", "before", "after"),
    [(1.0, True, True), (1.0, False, False), (-1.0, True, False), (4.5, False, True)],
)
def test_a_verdict_stays_between_its_limits(intervals, fall, before, after):
    """`fall` is the evidence, in sigmas; one more interval changes that of 50 km by little."""
    interval = next(iter(intervals(np.full(1100, 15.0), height=lambda odometer: 0.0 * odometer)))
    road = 50e3
    correlation = -fall / np.hypot(fall, np.sqrt(road / ALIKE))
    sums = (road, 0.0, 0.0, 1e-4 * road, 1e-4 * correlation * road, 1e-4 * road)
    detector = GradeDetector(sums, before).after(interval, 0.0, 2e4)
    assert detector.detected == (GRADE_SIGN if after else None)
