"""How what arrives is cut into blocks changes nothing that the account counts."""

from dataclasses import fields
import math

import numpy as np
import pytest

from evpinn_ros.core.energy.account import EnergyAccount
from evpinn_ros.core.energy.meter import EnergyMeter, EnergyState
from evpinn_ros.core.energy.rknn import load_rknn
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading

START = 1_700_000_000_000_000_000
RKNN = load_rknn()
SECONDS = 400


def arrivals(seed, period, told):
    """Calls of an account in order: a drive with lost and repeated readings.

    Its battery is silent twice, once together with the speed, and its clock leaps ahead.

    Args:
        seed: of what is random.
        period: of battery readings, s.
        told: whether the estimator tells the energy of dropouts.
    """
    rng, calls = np.random.default_rng(seed), []
    silences = ((100.0, 190.0), (250.0, 258.0))
    for tick in range(SECONDS * 2):
        t = tick / 2
        ns = START + tick * 500_000_000 + (5_000_000_000 if t > 300.0 else 0)
        power = 12e3 + 25e3 * math.sin(t / 7.0) + 2e3 * rng.normal()
        heard = not any(begin < t < end for begin, end in silences)
        if heard and tick % round(2 * period) == 0 and rng.random() > 0.02:
            calls.append(("add_measured", ns, power, 50.0))
            charge = round((0.8 - t / 4e3) * 200) / 200
            battery = BatteryReading(ns, 380.0 - power / 2e4, -power / 380, charge)
            calls.append(("add_block", battery))
        if not 120.0 < t < 130.0 and rng.random() > 0.02:
            calls.append(("add_block", SpeedReading(ns, 32.0 + 8.0 * math.sin(t / 11.0))))
            energy = (300.0, 11e3) if told and not heard else (math.nan, math.nan)
            lagging = ns - 300_000_000
            calls.append(("add_predicted", lagging, 1.05 * power, 900.0, *energy))
        if rng.random() < 0.01:
            calls.append(("add_predicted", ns, math.nan, 900.0, math.nan, math.nan))
    return calls


def counted(calls, cut):
    """States at all predictions, summary and saved account, for blocks of these sizes."""
    account = EnergyAccount(EnergyMeter(RKNN), "bmw_i3", 7e7)
    account.usual = 550.0
    blocks, left = [], next(cut)
    for name, *row in calls:
        rows = [Block.of(row)] if name == "add_block" else map(np.atleast_1d, row)
        getattr(account, name)(*rows)
        left -= 1
        if left == 0:
            blocks.append(account.count())
            left = next(cut)
    blocks.append(account.flush())
    columns = {
        field.name: np.concatenate([getattr(block, field.name) for block in blocks], axis=-1)
        for field in fields(EnergyState)
    }
    return columns, account


def every(size):
    while True:
        yield size


def random_sizes(seed):
    rng = np.random.default_rng(seed)
    while True:
        yield int(rng.integers(1, 300))


@pytest.mark.parametrize(
    ("seed", "period", "told"), [(0, 0.5, True), (1, 2.0, False), (2, 5.0, True)]
)
def test_cuts_change_nothing(seed, period, told):
    calls = arrivals(seed, period, told)
    whole, account = counted(calls, every(len(calls) + 1))
    assert account.reconciled is not None and account.gauge.learned + account.battery.samples > 0
    summary = account.summary()
    for cut in (every(7 if seed else 1), every(64), random_sizes(seed)):
        columns, other = counted(calls, cut)
        for name, column in whole.items():
            np.testing.assert_allclose(columns[name], column, rtol=1e-9, atol=1e-6, err_msg=name)
        again = other.summary()
        assert again.lifetime == pytest.approx(summary.lifetime, rel=1e-9, abs=1e-6)
        assert again.consumption == pytest.approx(summary.consumption, rel=1e-9)
        assert again.charge == pytest.approx(summary.charge, rel=1e-9, nan_ok=True)
        assert again.capacity == pytest.approx(summary.capacity, rel=1e-9)
        assert again.remaining == pytest.approx(summary.remaining, rel=1e-9)
        assert other.reconciled.verdict is account.reconciled.verdict
        assert other.reconciled[2:4] == pytest.approx(account.reconciled[2:4], rel=1e-9)
        state, same = other.battery.saved(), account.battery.saved()
        assert state.samples == same.samples
        assert state.state == pytest.approx(same.state, rel=1e-9)


def test_the_order_of_what_waits_changes_nothing():
    """Powers and readings of a drive in any order, before they are counted."""
    calls = [call for call in arrivals(0, 0.5, told=True) if call[0] != "add_predicted" or
             not math.isnan(call[2])]  # fmt: skip
    in_order, account = counted(calls, every(len(calls) + 1))
    shuffled = [calls[place] for place in np.random.default_rng(0).permutation(len(calls))]
    columns, other = counted(shuffled, every(len(calls) + 1))
    for name, column in in_order.items():
        np.testing.assert_allclose(columns[name], column, rtol=1e-9, atol=1e-6, err_msg=name)
    assert other.summary().lifetime == pytest.approx(account.summary().lifetime, rel=1e-9)
