"""Whether charging tells the sign of the current; acceleration is tested with the estimator."""

import math

import pytest

from evpinn_ros.signals.sign_detectors import ChargeDetector


def fed(power, charges, *, speed=math.nan, step=1.0):
    suspicion = ChargeDetector()
    for charge in charges:
        suspicion.update(power, charge, speed, step)
    return suspicion


RISING = [0.5 + 0.0001 * second for second in range(600)]
FALLING = [1.0 - charge for charge in RISING]
UNKNOWN = [math.nan] * 600


@pytest.mark.parametrize(
    ("power", "charges", "suspected"),
    [
        (-11_000.0, RISING, False),
        (11_000.0, RISING, True),
        (15_000.0, FALLING, False),
        (-15_000.0, FALLING, True),
    ],
)
def test_charge_goes_with_the_energy(power, charges, suspected):
    found = fed(power, charges)
    assert found.judged and found.suspected is suspected


@pytest.mark.parametrize("charges", [RISING[:150], UNKNOWN, [0.7] * 600])
def test_too_little_says_nothing(charges):
    assert not fed(11_000.0, charges).judged


def test_bookkeeping_at_rest_is_no_charging():
    """A rested battery's charge is corrected upwards while a light burns."""
    assert not fed(100.0, RISING).judged


@pytest.mark.parametrize(
    ("power", "speed", "judged", "suspected"),
    [
        (50_000.0, 0.0, True, True),
        (-50_000.0, 0.0, True, False),
        (12_000.0, 0.0, False, False),  # heats cabin and battery
        (50_000.0, 20.0, False, False),  # drives
        (50_000.0, math.nan, False, False),
    ],
)
def test_a_car_at_rest_draws_little(power, speed, judged, suspected):
    found = fed(power, UNKNOWN[:120], speed=speed)
    assert (found.judged, found.suspected) == (judged, suspected)


def test_a_moment_of_much_is_no_charging():
    assert not fed(80_000.0, UNKNOWN[:5], speed=0.0).judged


def test_the_verdict_is_withdrawn():
    found = fed(11_000.0, RISING)
    for charge in (RISING[-1] - 0.0001 * second for second in range(600)):
        found.update(11_000.0, charge, math.nan, 1.0)
    assert found.judged and not found.suspected
