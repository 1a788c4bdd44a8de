"""Charging and acceleration show the sign of the current; of grade: `test_grade_detector.py`."""

import math

import pytest

from evpinn_ros.common.saved_fields import StateError, plain, read
from evpinn_ros.core.signals.detector import CURRENT_SIGN
from evpinn_ros.core.signals.sign_detectors import ChargeDetector, GradeDetector, SignDetector


def fed(power, charges, *, speed=math.nan, step=1.0, detector=None):
    detector = detector or ChargeDetector()
    for charge in charges:
        detector = detector.after(power, charge, speed, step)
    return detector


RISING = [0.5 + 0.0001 * second for second in range(600)]
FALLING = [1.0 - charge for charge in RISING]
UNKNOWN = [math.nan] * 600


@pytest.mark.parametrize(
    ("power", "charges", "verdict"),
    [
        (-11_000.0, RISING, False),
        (11_000.0, RISING, True),
        (15_000.0, FALLING, False),
        (-15_000.0, FALLING, True),
    ],
)
def test_charge_goes_with_the_energy(power, charges, verdict):
    assert fed(power, charges).verdict is verdict


@pytest.mark.parametrize("charges", [RISING[:150], UNKNOWN, [0.7] * 600])
def test_too_little_says_nothing(charges):
    assert fed(11_000.0, charges).verdict is None


def test_bookkeeping_at_rest_is_no_charging():
    """A rested battery's charge is corrected upwards while a light burns."""
    assert fed(100.0, RISING).verdict is None


@pytest.mark.parametrize(
    ("power", "speed", "verdict"),
    [
        (50_000.0, 0.0, True),
        (-50_000.0, 0.0, False),
        (12_000.0, 0.0, None),  # heats cabin and battery
        (50_000.0, 20.0, None),  # drives
        (50_000.0, math.nan, None),
    ],
)
def test_a_car_at_rest_draws_little(power, speed, verdict):
    assert fed(power, UNKNOWN[:120], speed=speed).verdict is verdict


def test_a_moment_of_much_is_no_charging():
    assert fed(80_000.0, UNKNOWN[:5], speed=0.0).verdict is None


def test_the_verdict_is_withdrawn():
    rising = fed(11_000.0, RISING)
    assert rising.detected == CURRENT_SIGN
    back = [RISING[-1] - 0.0001 * second for second in range(600)]
    assert fed(11_000.0, back, detector=rising).verdict is False


def pulling(wrong: float, seconds: int, detector=None) -> SignDetector:
    """The detector after 1 m/s^2 at 10 m/s, a share of the time with power of the wrong sign."""
    detector = detector or SignDetector()
    for k in range(seconds):
        power = 1e4 if k % 10 < round(10 * (1 - wrong)) else -1e4
        detector = detector.after(10.0, 1.0, power, 1.0)
    return detector


def test_acceleration_shows_the_sign_with_hysteresis():
    """Detected above half of the power against the acceleration, cleared when none is; ever."""
    detector = pulling(0.7, 400)
    assert detector.verdict is None
    detector = pulling(0.9, 400, detector)
    assert detector.detected == CURRENT_SIGN
    detector = pulling(0.7, 400, detector)
    assert detector.detected == CURRENT_SIGN
    assert pulling(0.2, 400, detector).verdict is False


@pytest.mark.parametrize("kind", [SignDetector, GradeDetector])
def test_what_was_saved_before_the_verdict_had_three_values_is_read(kind):
    """Files of 0.2.0; the verdict comes back with the next seconds, from the sums."""
    older = {"sums": plain(kind())["sums"], "suspected": True, "told": True, "detected": True}
    assert read(kind, older) == kind()
    for sums in ([math.nan] * 3, [1.0] * 4, None):
        with pytest.raises(StateError):
            read(kind, {**older, "sums": sums})
