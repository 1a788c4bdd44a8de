"""Signs that contradict the physics are named, and right ones never."""

from dataclasses import replace
import json
import math

import numpy as np
import pytest

from evpinn_ros.estimation.car import LearnedCar
from evpinn_ros.estimation.grade_detector import GradeDetector
from evpinn_ros.estimation.terms import Warmth, equation_of
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample
from evpinn_ros.signals.sign_detectors import SignDetector


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
        for one in self._intervals(speed, height=self._height, begin_ns=self._begin * 10**9):
            rows = self.equation.rows(one.steps, one.conditions, Warmth(0.0, 0.0))
            drawn = float(rows.sum(0) @ self.equation.mean)
            steps = one.steps._replace(
                climb=sign * one.steps.climb + 0.02 * self._rng.standard_normal(6)
            )
            energy = drawn + 5e3 * self._rng.standard_normal()
            measured = replace(one, energy=energy, sampling_variance=0.0, steps=steps)
            self.car = self.car.after([measured])
            suspected |= self.car.grade.detected
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
    assert not hills.drive(1800, sign)


@pytest.mark.slow
def test_a_flipped_grade_is_found_within_ten_kilometres_and_mended(hills):
    hills.drive(660, -1.0)
    assert hills.car.grade.detected
    hills.drive(5400, 1.0)
    assert not hills.car.grade.detected


def test_a_verdict_keeps_its_six_sums(hills):
    hills.drive(300, -1.0)
    assert len(hills.car.grade.sums) == 6
    with pytest.raises(ValueError, match="sums are missing"):
        GradeDetector(sums=(0.0,) * 5)


def test_a_current_of_the_wrong_sign_is_saved_and_what_does_not_fit_is_refused():
    current = SignDetector()
    for k in range(300):
        moment = Sample(k * NANOSECONDS, 10.0, 1.0 if k % 2 else -1.0, 0.0, 1.17, 0.0)
        current.update(moment, -2e4 if k % 2 else 2e4, 1.0)
    assert current.suspected
    saved = json.loads(json.dumps(current.export()))
    other = SignDetector()
    other.restore(saved)
    assert other.export() == saved and other.suspected == current.suspected
    for sums in ([math.nan] * len(saved["sums"]), saved["sums"][:-1], None):
        with pytest.raises((TypeError, ValueError)):
            other.restore({**saved, "sums": sums})
    assert other.export() == saved


def test_a_hair_around_the_limit_does_not_flicker():
    """Suspected below -0.5 of the share of power that goes with inertia, cleared above 0."""
    current = SignDetector()

    def feed(wrong: float, seconds: int) -> bool:
        """Whether a share of power against the acceleration is suspected."""
        for k in range(seconds):
            sign = 1.0 if k % 10 < round(10 * (1 - wrong)) else -1.0
            current.update(Sample(0, 10.0, 1.0, 0.0, 1.17, 0.0), sign * 1e4, 1.0)
        return current.suspected

    assert not feed(0.7, 400)
    assert feed(0.9, 400)
    assert feed(0.7, 400)
    assert not feed(0.2, 400)
