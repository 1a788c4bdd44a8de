"""Time of which nothing is known is in sigma from its first second, whoever was away."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.account import EnergyAccount
from evpinn_ros.core.energy.hole import LONGEST, RecentPower, recent_powers, taken_variance
from evpinn_ros.core.energy.meter import EnergyMeter
from evpinn_ros.core.energy.quadrature import EnergyIntegral
from evpinn_ros.core.energy.rknn import load_rknn
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading

START, VEHICLE = 1_700_000_000 * NANOSECONDS, "bmw_i3"
RKNN = load_rknn()
RATE, BEGIN = 5, 150.0  # samples a second; s, before which all is heard


def account():
    return EnergyAccount(EnergyMeter(RKNN), VEHICLE, 7e7)


def power(at):
    """A drive through hills, with traffic."""
    return 11e3 + 25e3 * np.sin(at / 7.0) + 12e3 * np.sin(at / 2.3)


def drive(counted, begin, end, *, predicted=True, charge=None):
    at = np.arange(begin, end, 1 / RATE)
    stamps, drawn = START + np.rint(at * NANOSECONDS).astype(np.int64), power(at)
    if predicted:
        unknown = np.full(len(at), math.nan)
        counted.add_predicted(stamps, drawn, np.full(len(at), 300.0), unknown, unknown)
    counted.add_measured(stamps, drawn, np.full(len(at), 100.0))
    if charge is not None:
        rows = zip(stamps.tolist(), (-drawn / 380).tolist(), map(charge, at), strict=True)
        counted.add_block(Block.of(BatteryReading(ns, 380.0, *row) for ns, *row in rows))
    counted.flush()


def restarted(counted):
    """A new process that goes on from what the other saved."""
    anew = account()
    anew.restore(counted.export())
    return anew


def after(seconds, away, **options):
    """An account whose inputs were silent for so long, or which was away itself."""
    counted = account()
    drive(counted, 0.0, BEGIN, **options)
    counted = restarted(counted) if away else counted
    drive(counted, BEGIN + seconds, BEGIN + seconds + 30.0, **options)
    return counted


def truth(begin, end):
    at = np.linspace(begin, end, 20_001)
    values = power(at)
    return float(((values[1:] + values[:-1]) / 2).mean() * (end - begin))


@given(st.floats(2.5, LONGEST - 1.0), st.booleans(), st.booleans())
def test_what_may_have_been_taken_in_a_hole_is_in_sigma(seconds, away, predicted):
    state = after(seconds, away, predicted=predicted).state
    error = state.consumed - truth(0.0, BEGIN + seconds + 30.0 - 1 / RATE)
    assert abs(error) < 2.0 * state.consumed_sigma
    assert state.unknown_s == pytest.approx(seconds, abs=0.5)


@given(st.floats(0.5, 120.0))
def test_a_restart_costs_as_much_sigma_as_a_silence_of_the_same_time(seconds):
    """Silences below the longest step are integrated across."""
    away = after(seconds, away=True).state
    if seconds > 2.5:
        silent = after(seconds, away=False).state
        assert away.consumed_sigma == pytest.approx(silent.consumed_sigma, rel=0.05)
    assert away.consumed_sigma > 0.5 * seconds * math.sqrt(truth(0.0, BEGIN) / BEGIN)


@pytest.mark.parametrize("away", [False, True])
@pytest.mark.parametrize("cut", [7.0, 1e4])
def test_what_many_holes_lack_adds_up(away, cut):
    """However the drive is cut into blocks, for dropouts may end in one."""
    counted, whole, end = account(), account(), 0.0
    for _ in range(20):
        begin, end = end + 4.0, end + 34.0
        drive(whole, begin, end)
        while begin < end:
            drive(counted, begin, min(begin + cut, end))
            begin += cut
        counted = restarted(counted) if away else counted
    state = counted.state
    assert abs(state.consumed - truth(0.0, end)) < 2.0 * state.consumed_sigma
    if not away:
        assert state.consumed_sigma == pytest.approx(whole.state.consumed_sigma, rel=1e-9)


def test_a_night_and_a_jump_of_time_are_no_holes():
    counted = account()
    drive(counted, 0.0, BEGIN)
    before = counted.state
    morning = restarted(counted)
    drive(morning, BEGIN + LONGEST + 1.0, BEGIN + LONGEST + 3.0)
    counted.begin_after_jump()
    drive(counted, BEGIN + 60.0, BEGIN + 62.0)
    for later in (morning, counted):
        assert later.state.unknown_s == 0.0
        assert later.state.consumed_sigma < 1.1 * before.consumed_sigma


def test_a_hole_is_kept_over_a_restart_in_which_nothing_came():
    counted = account()
    drive(counted, 0.0, BEGIN)
    counted = restarted(restarted(counted))
    drive(counted, BEGIN + 60.0, BEGIN + 62.0)
    assert counted.state.unknown_s == pytest.approx(60.0, abs=0.5)


@pytest.mark.parametrize("away", [False, True])
def test_the_state_of_charge_closes_a_hole(away):
    """Steps of half a percent of 70 MJ are surer than ten minutes of anything."""
    seconds = 590.0

    def charge(at):
        return 0.8 - truth(0.0, at) / 7e7

    told, untold = (after(seconds, away, charge=given) for given in (charge, lambda at: math.nan))
    assert told.state.consumed_sigma < 0.5 * untold.state.consumed_sigma
    error = told.state.consumed - truth(0.0, BEGIN + seconds + 30.0)
    assert abs(error) < 2.0 * told.state.consumed_sigma


@given(st.integers(0, 2**32), st.integers(1, 40))
def test_recent_power_is_the_same_however_it_is_cut(seed, cut):
    rng = np.random.default_rng(seed)
    stamps = START + (rng.uniform(0.1, 3.0, 40).cumsum() * NANOSECONDS).astype(np.int64)
    powers = rng.uniform(-3e4, 8e4, 40)
    whole = recent_powers(np.array(RecentPower()), EnergyIntegral().extend(stamps, powers))
    integral, rows = EnergyIntegral(), np.array([RecentPower()])
    for part in (slice(cut), slice(cut, None)):
        course = integral.extend(stamps[part], powers[part])
        rows = np.concatenate((rows, recent_powers(rows[-1], course)[1:]))
    assert np.array_equal(whole, rows)
    seconds, before = np.array([0.0, 1.0, 9.0]), np.zeros(3)
    variances = taken_variance(whole[[-1, -1, -1]], seconds, before)
    assert variances[0] == 0.0 < variances[1] < variances[2]
