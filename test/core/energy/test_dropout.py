import math

import pytest

from evpinn_ros.core.energy.charge import UNKNOWN, Uncertain
from evpinn_ros.core.energy.dropout import Bridge, Dropout, Verdict, reconcile

WH = 3600.0


def silence(energy=1000 * WH, sigma=60 * WH, duration=600.0, covered=600.0):
    bridge = Bridge(energy, 0.0, abs(energy), covered)
    return Dropout(0, duration, bridge, sigma)


@pytest.mark.parametrize(
    ("dropout", "by_charge", "verdict"),
    [
        (silence(), UNKNOWN, Verdict.PREDICTED),
        (silence(duration=59.0, covered=59.0), Uncertain(1100 * WH, 60 * WH), Verdict.SHORT),
        (silence(), Uncertain(2000 * WH, 60 * WH), Verdict.CONTRADICTED),
        (silence(covered=100.0), Uncertain(-9000 * WH, 60 * WH), Verdict.CHARGED),
    ],
)
def test_what_the_charge_cannot_say_changes_nothing(dropout, by_charge, verdict):
    joined = reconcile(dropout, by_charge)
    assert (joined.verdict, joined.correction) == (verdict, 0.0)
    assert math.isnan(joined.by_charge.value) == (by_charge is UNKNOWN)


def test_two_statements_are_joined_by_their_variances():
    joined = reconcile(silence(), Uncertain(1100 * WH, 60 * WH))
    assert joined.verdict is Verdict.JOINED
    assert joined.correction == pytest.approx(50 * WH)
    assert joined.variance_taken == pytest.approx((60 * WH) ** 2 / 2)
    rough = reconcile(silence(), Uncertain(1100 * WH, 600 * WH))
    assert rough.correction == pytest.approx(1 * WH, rel=0.02)


def test_where_speed_was_silent_too_the_state_of_charge_counts_alone():
    joined = reconcile(silence(covered=300.0), Uncertain(2000 * WH, 50 * WH))
    assert joined.verdict is Verdict.CHARGE_ALONE
    assert joined.correction == pytest.approx(1000 * WH)
    assert joined.variance_taken == pytest.approx((60 * WH) ** 2 - (50 * WH) ** 2)
    rough = reconcile(silence(covered=300.0), Uncertain(1100 * WH, 80 * WH))
    assert rough.verdict is Verdict.JOINED and rough.variance_taken > 0.0
