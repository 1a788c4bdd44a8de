"""Signs that contradict the physics are named, and right ones never."""

import json
import math

import numpy as np
import pytest

from evpinn_ros.estimation.grade_suspicion import GradeSuspicion
from evpinn_ros.estimation.published_filter import PublishedFilter
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample
from evpinn_ros.signals.suspicion import SignSuspicion
from evpinn_ros.vehicle.identifiable import combined_power, identifiable
from evpinn_ros.vehicle.parameters import Parameters

TRUTH = Parameters(eta=0.85, mu=0.78, mass=1960.0, c_rr=0.0105, c_d=0.235, p_aux=1250.0)


class Hills:
    """A car on a country road whose hills a sensor tells `sign` times."""

    def __init__(self, vehicle) -> None:
        self.filter, self.grade = PublishedFilter(vehicle), GradeSuspicion()
        self._vehicle, self._rng, self._second = vehicle, np.random.default_rng(0), 0

    def drive(self, seconds: int, sign: float) -> bool:
        """At 1 Hz; whether the sign of grade was suspected at any time."""
        suspected = False
        for _ in range(seconds):
            self._second += 1
            speed = 15.0 + 3.0 * math.sin(self._second / 20)
            acceleration = 0.15 * math.cos(self._second / 20)
            grade = 0.02 * math.sin(self._second / 15) + 0.01 * math.sin(self._second / 40)
            power = combined_power(
                speed,
                acceleration,
                identifiable(TRUTH, self._vehicle.frontal_area),
                air_density=self._vehicle.air_density,
                grade=grade + 0.005 * self._rng.standard_normal(),
                rotating_mass_factor=self._vehicle.rotating_mass_factor,
            )
            told = sign * (grade + 0.005 * self._rng.standard_normal())
            moment = Sample(self._second * NANOSECONDS, speed, acceleration, told, 1.17, 0.0)
            self.filter.advance(moment)
            self.filter.update(moment, power, 1.0)
            self.grade.push(self.filter, moment, power, 1.0)
            suspected |= self.grade.suspected
        return suspected


@pytest.fixture
def hills(vehicle) -> Hills:
    return Hills(vehicle)


@pytest.mark.parametrize("sign", [1.0, 0.0])
def test_a_right_grade_and_none_are_never_suspected(hills, sign):
    assert not hills.drive(1800, sign)


def test_a_flipped_grade_is_found_within_ten_kilometres_and_mended(hills):
    hills.drive(660, -1.0)
    assert hills.grade.suspected
    hills.drive(5400, 1.0)
    assert not hills.grade.suspected


def test_both_are_saved_and_what_does_not_fit_is_refused(hills):
    hills.drive(300, -1.0)
    current = SignSuspicion()
    for k in range(300):
        moment = Sample(k * NANOSECONDS, 10.0, 1.0 if k % 2 else -1.0, 0.0, 1.17, 0.0)
        current.push(moment, -2e4 if k % 2 else 2e4, 1.0)
    assert current.suspected
    for suspicion in (hills.grade, current):
        saved = json.loads(json.dumps(suspicion.export()))
        other = type(suspicion)()
        other.restore(saved)
        assert other.export() == saved and other.suspected == suspicion.suspected
        for sums in ([math.nan] * len(saved["sums"]), saved["sums"][:-1], None):
            with pytest.raises((TypeError, ValueError)):
                other.restore({**saved, "sums": sums})
        assert other.export() == saved


def test_a_hair_around_the_limit_does_not_flicker():
    """Suspected below -0.5 of the share of power that goes with inertia, cleared above 0."""
    current = SignSuspicion()

    def push(wrong: float, seconds: int) -> bool:
        """Of a share of power against the acceleration."""
        for k in range(seconds):
            sign = 1.0 if k % 10 < round(10 * (1 - wrong)) else -1.0
            current.push(Sample(0, 10.0, 1.0, 0.0, 1.17, 0.0), sign * 1e4, 1.0)
        return current.suspected

    assert not push(0.7, 400)
    assert push(0.9, 400)
    assert push(0.7, 400)
    assert not push(0.2, 400)
