from contextlib import nullcontext
import json
import math

import numpy as np
import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.battery_model import BatteryModel
from evpinn_ros.core.energy.dropout import Verdict
from evpinn_ros.core.energy.forecast import EnergyCurve
from evpinn_ros.core.energy.meter import EnergyMeter
from evpinn_ros.core.energy.rknn import Rknn
from evpinn_ros.core.signals.admission import MAX_POWER
from evpinn_ros.core.signals.readings import MAX_SPEED, BatteryReading, SpeedReading
from test.core.energy.cars import LiveAccount

START = 1_700_000_000_000_000_000
CAPACITY = 70e6  # J
SPEED = 20.0  # m/s
NEVER = range(0)


def itself(power, energy=0.0):
    return power


CLASSICAL = Rknn((itself, itself, itself, itself))  # the network is tested elsewhere


def account(capacity=CAPACITY, vehicle="bmw_i3"):
    return LiveAccount(EnergyMeter(CLASSICAL), vehicle, capacity)


def drive(
    to, seconds, *, power=10e3, predicted=10.5e3, silent=NEVER, blind=NEVER, first_charge=0.9,
    together=True,
):  # fmt: skip
    """2 Hz; the battery with its charge is silent in one range, speed in another.

    The state of charge falls as the power says, from second 0 on, in steps of 1 / 500.
    """
    with to.together() if together else nullcontext():
        for tick in range(seconds.start * 2, seconds.stop * 2 + 1):
            t, stamp = tick / 2, START + tick * 500_000_000
            if not silent.start < t < silent.stop:
                charge = first_charge - power * t / CAPACITY
                charge_shown = round(charge * 500) / 500
                to.add_reading(BatteryReading(stamp, math.nan, math.nan, charge_shown))
                to.add_measured(stamp, power, 30.0)
            if not blind.start < t < blind.stop:
                to.add_speed(stamp, SPEED)
                to.add_predicted(stamp, predicted, 1e3)
    return to


@pytest.fixture(scope="module")
def minute():
    """A saved account of a minute's drive."""
    return drive(account(), range(60)).export()


@pytest.fixture(scope="module")
def hour():
    """A saved account of an hour's drive, from which the capacity was learned."""
    return drive(account(), range(3600)).export()


def restored(saved):
    counted = account()
    counted.restore(json.loads(json.dumps(saved, allow_nan=False)))
    return counted


def test_totals_and_consumption_of_a_drive():
    summary = drive(account(), range(600)).summary()
    assert summary.since_reset.net.value == pytest.approx(6e6)
    assert summary.since_reset.drawn == pytest.approx(6e6)
    assert summary.since_reset.distance == pytest.approx(12e3)
    assert set(summary.consumption) == {"1", "10", "trip", "lifetime"}
    assert all(cost == pytest.approx(500.0, rel=1e-3) for cost in summary.consumption.values())
    assert summary.usable.value == pytest.approx((0.9 - 6 / 70) * CAPACITY, rel=0.01)
    expected = summary.usable.value / 500.0
    assert summary.remaining.lower < expected < summary.remaining.upper
    assert summary.remaining.distance == pytest.approx(expected, rel=1e-2)


def test_the_speed_of_now_is_the_newest_until_speed_is_silent():
    counted = account()
    assert counted.speed == 0.0 and drive(counted, range(60)).speed == SPEED
    assert drive(counted, range(60, 70), blind=range(60, 71)).speed == 0.0


def test_a_drive_in_one_block_is_one_of_values_one_by_one():
    """The energy at a speed holds the power of its moment."""
    one_by_one, block = (
        drive(account(), range(300), together=together).summary() for together in (False, True)
    )
    assert block.consumption == pytest.approx(one_by_one.consumption, rel=1e-9)


def test_a_reset_of_the_trip_leaves_the_lifetime_and_the_charge():
    counted = drive(account(), range(300))
    charge = counted.charge()
    counted.reset_trip()
    assert counted.since_reset().net.value == 0.0
    assert counted.lifetime().net.value == pytest.approx(3e6)
    assert counted.charge() == charge
    drive(counted, range(300, 600))
    assert counted.since_reset().net.value == pytest.approx(3e6)
    assert counted.lifetime().net.value == pytest.approx(6e6)
    assert counted.lifetime().distance == pytest.approx(12e3)
    assert counted.summary().consumption["10"] == pytest.approx(500.0, rel=1e-3)


@pytest.mark.slow
def test_a_silence_is_reconciled_with_the_state_of_charge(hour):
    """The prediction is 20 % low over a silence of 20 minutes; charge tells most of that."""
    counted = restored(hour)
    assert counted.gauge.learned
    before = counted.lifetime().net.value
    drive(counted, range(3600, 5460), predicted=9e3, silent=range(3660, 4860))
    silence = counted.reconciled
    assert silence.verdict is Verdict.JOINED
    assert silence.dropout.duration == pytest.approx(1200.0, abs=1.0)
    assert silence.dropout.bridge.energy == pytest.approx(10.8e6, rel=0.01)
    assert silence.by_charge.value == pytest.approx(12e6, abs=2 * silence.by_charge.sigma)
    error = counted.lifetime().net.value - before - 18.6e6
    assert abs(error) < 0.5 * 1.2e6
    net = counted.since_reset().net
    course = counted.meter.course
    assert net.sigma < course.states(course.end).consumed_sigma[0]
    uncorrected = sum(window.total.energy for window in counted.trip.windows[:1])
    assert uncorrected == pytest.approx(1e3 * 500.0, rel=0.1)  # no jump in the last kilometre


def test_without_a_state_of_charge_a_silence_stays_predicted():
    counted = drive(account(math.nan), range(300), silent=range(100, 200))
    assert counted.reconciled.verdict is Verdict.PREDICTED
    assert counted.since_reset().net.value == pytest.approx(2e6 + 1.05e6, rel=0.01)


@pytest.mark.slow
def test_speed_silent_too_is_counted_and_told_by_the_charge(hour):
    counted = restored(hour)
    drive(counted, range(3600, 5460), silent=range(3660, 4860), blind=range(3660, 4860))
    assert counted.reconciled.verdict is Verdict.CHARGE_ALONE
    assert counted.since_reset().unknown_s == pytest.approx(1200.0, abs=2.0)
    assert counted.since_reset().net.value == pytest.approx(54.6e6, rel=0.02)
    assert counted.since_reset().distance == pytest.approx((5460 - 1200) * SPEED, rel=1e-3)


def test_the_charge_is_projected_while_the_battery_is_silent():
    counted = drive(account(), range(600))
    heard = counted.charge()
    drive(counted, range(600, 1200), silent=range(600, 1300))
    summary = counted.summary()
    assert summary.projected
    assert summary.charge.value == pytest.approx(heard.value - 6.3e6 / CAPACITY, abs=0.003)
    assert summary.charge.sigma > heard.sigma


def test_usual_legs_count_in_the_distance_to_empty_once_there_is_a_long_run():
    """Before 10 km are driven there is no long run to return to."""
    counted = account()
    counted.usual = 500.0
    drive(counted, range(300))
    summary = counted.summary()
    assert summary.consumption["lifetime"] > 0.0 and "10" not in summary.consumption
    assert summary.remaining is None
    drive(counted, range(300, 600))
    far = counted.summary().remaining.distance
    counted.usual = 1000.0  # J/m: 3/4 of 500 more than the road so far, over a memory of 10 km
    assert far - counted.summary().remaining.distance == pytest.approx(3.75e6 / 500.0, abs=2.0)


def test_a_route_planned_before_setting_off_is_followed_until_it_is_driven():
    time, length = np.array([0.0, 50.0, 600.0]), np.array([0.0, 1e3, 12e3])
    energy = np.array([0.0, 1e6, 12e6])  # twice as much as usual
    planned, usual = account(), account()
    planned.follow(EnergyCurve(time, length, energy, 0.1 * energy))
    start = drive(planned, range(40)).summary()
    assert drive(usual, range(40)).summary().remaining is None
    assert start.remaining.distance == pytest.approx(start.usable.value / 1e3, abs=3.0)
    on_route = [drive(counted, range(41, 520)).summary().remaining for counted in (planned, usual)]
    left = 12e3 - 520 * SPEED
    assert on_route[0].distance == pytest.approx(on_route[1].distance - left, abs=30.0)
    over = [drive(counted, range(521, 620)).summary().remaining for counted in (planned, usual)]
    assert over[0] == over[1]


def horizon(power, seconds=8.0, count=81):
    """A plan of some seconds at `SPEED`, forecast at a constant power, W."""
    time = np.linspace(0.0, seconds, count)
    return EnergyCurve(time, SPEED * time, power * time, np.full(count, 1e3))


@pytest.mark.parametrize("power", [10e3, 120e3, -60e3])  # even speed, speeding up, braking
@pytest.mark.parametrize("driven", [20, 300, 700])  # s: nothing known, usual legs, 10 km
def test_the_horizon_of_a_controller_changes_nothing(power, driven):
    alone, planned = account(), account()
    if driven > 100:
        alone.usual = planned.usual = 600.0
    for counted in (alone, planned):
        drive(counted, range(driven))
    for second in range(driven, driven + 8):
        planned.follow(horizon(power))
        for counted in (alone, planned):
            drive(counted, range(second, second + 1))
        assert planned.summary().remaining == alone.summary().remaining


def test_a_horizon_does_not_end_the_route_that_is_followed():
    counted = drive(account(), range(20))
    counted.follow(horizon(40e3, seconds=600.0))
    route = counted.route
    counted.follow(horizon(-60e3))
    assert counted.route is route


def test_what_a_route_costs_counts_for_the_route_alone():
    """Before 10 km are driven the usual legs say what the road beyond it costs."""
    counted = drive(account(), range(300))
    counted.usual = 500.0
    counted.follow(horizon(40e3, seconds=150.0))  # 3 km of 2000 J/m
    summary = counted.summary()
    beyond = (summary.usable.value - 6e6) / summary.consumption["lifetime"]
    assert summary.remaining.distance == pytest.approx(3e3 + beyond, rel=0.01)


def test_a_route_is_followed_on_after_a_restart_and_not_the_next_morning():
    time, length = np.array([0.0, 50.0, 600.0]), np.array([0.0, 1e3, 12e3])
    energy = np.array([0.0, 1e6, 12e6])  # twice as much as usual
    first = drive(account(), range(600))
    first.follow(EnergyCurve(time, length, energy, 0.1 * energy))
    saved = json.loads(json.dumps(drive(first, range(600, 700)).export(), allow_nan=False))
    older = {name: value for name, value in saved.items() if name != "route"}
    once, another, without, morning = account(), account(), account(), account()
    once.restore(saved)
    another.restore(once.export())  # stopped before anything came
    without.restore(older)
    morning.restore(saved)
    left = first.route.left(first.odometer, 0)
    assert left == pytest.approx(12e3 - 101 * SPEED, abs=SPEED)
    on = [
        drive(counted, range(700, 720)).summary().remaining for counted in (once, another, without)
    ]
    assert on[0] == on[1]
    dearer = once.route.left(once.odometer, 0)  # by as many metres as cost twice as much
    assert left - 20 * SPEED <= dearer < left - 15 * SPEED
    assert on[2].distance - on[0].distance == pytest.approx(dearer, rel=0.05)
    late = [
        drive(counted, range(3000, 3020)).summary().remaining for counted in (morning, without)
    ]
    assert late[0].distance == pytest.approx(late[1].distance, rel=0.01)
    saved["route"]["energy"].pop()
    with pytest.raises(ValueError, match="route"):
        account().restore(saved)


@pytest.mark.parametrize("wrong", [1e9, -1e9, 1e308, math.inf, math.nan])
def test_what_no_car_can_do_is_refused_and_all_goes_on(wrong):
    """One speed of 1e9 m/s used to be 50 000 km of the lifetime; a power of 1e308 ended it."""
    counted, sound = account(), drive(account(), range(120))
    drive(counted, range(60))
    late = START + 60_250_000_000
    assert not counted.admission.admits(SpeedReading(late, wrong))
    counted.add_measured(late, wrong, 30.0)
    assert not counted.add_predicted(late, wrong, 1e3)
    counted.add_measured(late, 1e4, 1e308)
    assert not counted.add_predicted(late, 1e4, -1.0)
    drive(counted, range(60, 120))
    assert counted.summary().lifetime == pytest.approx(sound.summary().lifetime)
    assert counted.refused == {"speed_out_of_range": 1, "power_out_of_range": 4}
    json.dumps(counted.export(), allow_nan=False)


def test_the_largest_power_and_speed_that_are_taken_never_stop_the_account():
    counted = account()
    for second in range(1000):
        stamp = START + second * 1_000_000_000
        counted.add_speed(stamp, MAX_SPEED)
        counted.add_predicted(stamp, MAX_POWER, MAX_POWER)
    again = restored(counted.export())
    assert again.lifetime().distance == pytest.approx(999 * MAX_SPEED)


def changed(saved, path, value):
    """A copy of a saved account with one value changed."""
    saved = json.loads(json.dumps(saved))
    place = saved
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return saved


def test_a_state_of_charge_cannot_add_what_no_battery_can_give():
    """Full, then empty, a minute later: 70 MJ in 61 s of dropout are 1.1 MW; of 5 GJ 80 MW."""
    counted = drive(account(5e9), range(30), first_charge=1.0)
    drive(counted, range(95, 97), first_charge=0.01)
    assert counted.reconciled.verdict is Verdict.PREDICTED
    assert counted.lifetime().net.value < 1e6


@pytest.mark.slow
def test_the_lifetime_never_falls_whatever_time_does():
    """Jumps under both policies, trips reset, restarts from what was saved last."""
    counted, random = account(), np.random.default_rng(3)
    before = counted.lifetime()
    for _ in range(30):
        begin = int(random.integers(0, 500))
        drive(counted, range(begin, begin + 20), silent=range(begin, begin + 5))
        now = counted.lifetime()
        assert now.distance > before.distance and now.drawn > before.drawn
        match random.integers(4):
            case 0:
                counted.begin_after_jump()
            case 1:
                counted.begin_next_trip()
                assert counted.since_reset().distance == 0.0
            case 2:
                counted.reset_trip()
                counted.begin_after_jump()
            case _:
                counted = restored(counted.export())
        before = counted.lifetime()
        assert before == pytest.approx(now)


def test_a_prediction_that_a_slow_battery_puts_right_is_not_taken_back():
    counted = account()
    for tick in range(126):
        if tick % 6 == 0:
            counted.add_measured(START + tick * 500_000_000, 10e3, 30.0)
        counted.add_predicted(START + tick * 500_000_000, 30e3, 1e3)
    shown = counted.show().lifetime
    counted.add_measured(START + 63_000_000_000, 10e3, 30.0)
    assert counted.lifetime().drawn < shown.drawn == counted.show().lifetime.drawn


def test_what_predictions_have_bridged_is_not_counted_again_by_late_measurements():
    """After a restart a topic may be found later than the other one, and come all at once."""
    counted = restored(drive(account(), range(60)).export())
    for tick in range(120, 132):
        counted.add_predicted(START + tick * 500_000_000, 12e3, 1e3)
    shown = counted.state
    for tick in range(120, 132):
        counted.add_measured(START + tick * 500_000_000, 10e3, 30.0)
    late = counted.state
    assert (late.consumed, late.consumed_sigma) == (shown.consumed, shown.consumed_sigma)
    assert late.dropped == shown.dropped + 12
    drive(counted, range(66, 70))
    assert counted.state.consumed == pytest.approx(shown.consumed + 45e3, abs=6e3)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_published_never_falls_among_leaps(seed):
    """Stamps leap by 3 s, power changes its sign, samples are lost, the process restarts."""
    random, counted, skew = np.random.default_rng(seed), account(), 0.0
    before = counted.show().lifetime
    for tick in range(600):
        skew += random.choice([-3.0, 3.0]) if random.random() < 0.03 else 0.0
        if random.random() < 0.01:
            random.choice([counted.begin_after_jump, counted.begin_next_trip])()
        if random.random() < 0.01:
            counted.restore(json.loads(json.dumps(counted.export(), allow_nan=False)))
        stamp_ns, power = START + int((tick / 2 + skew) * 1e9), random.choice([10e3, -8e3, 30e3])
        if random.random() < 0.8:
            counted.add_measured(stamp_ns, power, 30.0)
        if random.random() < 0.9:
            counted.add_speed(stamp_ns, SPEED)
            counted.add_predicted(stamp_ns, 1.05 * power + 300.0 * random.normal(), 1e3)
        now = counted.show().lifetime
        assert now.drawn >= before.drawn and now.regenerated >= before.regenerated
        assert now.net.value == pytest.approx(counted.lifetime().net.value)
        before = now


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (["vehicle"], "tesla_model_s"),
        (["version"], 99),
        (["trip", "speed", "drawn"], 1e8),  # in a minute
        (["trip", "windows", 0, 0, 0], 1.0),  # a bucket of another size
        (["trip", "windows"], [[[0.0, 0.0]]]),
        (["meter", "measured", "drawn"], 1e12),
        (["meter", "rknn"], -1e12),
        (["battery", "state"], [370.0, 50.0]),
        (["battery", "samples"], 5),  # a battery of no voltage
        (["trip", "windows"], [[], [], []]),
        (["trip", "windows", 1], [["far", 0.0]]),
        (["trip", "windows", 2], [[-1.0, 0.0]]),
        (["meter", "bridged"], [0.0] * 5),
        (["charge", "capacity"], [1e12, 1.0]),
    ],
)
def test_a_saved_account_that_contradicts_itself_is_refused(minute, path, value):
    """And nothing changes by it; what ranges refuse is in `test_state_schema`."""
    counted = restored(minute)
    before = counted.export()
    with pytest.raises(InputError, match="saved"):
        counted.restore(changed(minute, path, value))
    assert counted.export() == before


def test_the_battery_is_learned_from_what_the_account_is_told():
    counted, alone = account(), BatteryModel(CAPACITY)
    for second in range(100):
        stamp = START + second * 1_000_000_000
        values = 360.0 - second % 7, second % 5 - 20.0, 0.9
        alone.extend(np.array([stamp]), *np.array([values]).T)
        counted.add_reading(BatteryReading(stamp, *values))
        counted.count()
    assert counted.battery.samples == alone.samples > 50
    assert counted.battery.export() == alone.export()
