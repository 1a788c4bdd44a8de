"""The energy node's account: what outlives a restart, and what planners hear of it."""

from itertools import pairwise
import json

import numpy as np
import pytest
from std_srvs.srv import Trigger

from evpinn_ros import topics
from evpinn_ros.core.energy.path_plan import plan_from_path
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.topics.messages import Level, read_named_vector
from test.nodes.plans import ANSWERS, ask, path, power, profile

START = 1_700_000_000
SPEED = 50.0  # m/s
POWER = 15e3  # W
SUMMARY = (topics.ENERGY_TOTALS, topics.ENERGY_CONSUMPTION, topics.ENERGY_RANGE)


def drive(bench, node, seconds, *, battery=True):
    """A message of each kind a second; returns when the node has dealt with them."""
    for second in seconds:
        stamp = (START + second) * NANOSECONDS
        bench.read(node, SpeedReading(stamp, SPEED))
        if battery:
            bench.read(node, BatteryReading(stamp, 350.0, -POWER / 350.0, 0.8))
            bench.deliver(node, topics.POWER_MEASURED, power(stamp, POWER))
        bench.deliver(node, topics.POWER_SMOOTHED, power(stamp, POWER + 1e3))
        node.count()


def values(message):
    return read_named_vector(message).values


def hear_totals(bench, node):
    """Totals from now on, once the node knows who listens."""
    listeners = bench.node.count_subscribers(topics.ENERGY_TOTALS.under())
    heard = bench.hear(topics.ENERGY_TOTALS)
    bench.pump(lambda: node.count_subscribers(topics.ENERGY_TOTALS.under()) > listeners)
    return heard


def test_a_planner_hears_consistent_totals_across_a_restart(bench, tmp_path):
    """Subscribed before and after: energy since reset never starts over or jumps."""
    file = str(tmp_path / "energy.json")
    first = bench.start(EnergyNode, energy_file=file)
    before = hear_totals(bench, first)
    drive(bench, first, range(60))
    bench.pump(lambda: len(before) == first.published[topics.ENERGY_TOTALS])
    bench.stop(first)
    heard = len(before)
    second = bench.start(EnergyNode, energy_file=file)
    bench.pump(lambda: second.count_subscribers(topics.ENERGY_TOTALS.under()) > 0)
    drive(bench, second, range(65, 90))
    after = hear_totals(bench, second)
    drive(bench, second, range(90, 120))
    bench.pump(lambda: len(before) == heard + second.published[topics.ENERGY_TOTALS])
    bench.pump(lambda: after and after[-1] == before[-1])
    assert before[-len(after) :] == after
    net = [values(message)["net"] for message in before]
    steps = [b - a for a, b in pairwise(net)]
    assert min(steps) >= 0.0 and max(steps) <= 2 * POWER
    # 59 s and 54 s of driving; the five seconds between nobody heard.
    assert net[-1] == pytest.approx((59 + 54) * POWER)
    assert values(before[-1])["lifetime_net"] == net[-1]


def test_planners_hear_consumption_and_range_only_when_known(bench):
    node = bench.start(EnergyNode)
    bench.listen(*SUMMARY)
    drive(bench, node, range(15))
    bench.settle()
    consumption = values(bench.heard[topics.ENERGY_CONSUMPTION][-1])
    assert set(consumption) == {"distance_trip", "distance_lifetime"}
    known = values(bench.heard[topics.ENERGY_RANGE][-1])
    assert set(known) == {"usable_energy", "state_of_charge", "capacity"}
    drive(bench, node, range(15, 211))  # 10 km are full
    bench.settle()
    consumption = values(bench.heard[topics.ENERGY_CONSUMPTION][-1])
    cost = POWER / SPEED / 3.6  # energy is known one sample later than speed
    assert consumption["wh_per_km_1"] == pytest.approx(cost, rel=5e-3)
    assert consumption["wh_per_km_10"] == pytest.approx(cost, rel=5e-3)
    assert "wh_per_km_100" not in consumption
    vector = bench.heard[topics.ENERGY_RANGE][-1]
    shown = values(vector)
    assert shown["state_of_charge"] == pytest.approx(0.8, abs=1e-6)
    expected = shown["usable_energy"] * SPEED / POWER
    assert shown["distance_to_empty"] == pytest.approx(expected, rel=1e-2)
    assert shown["distance_lower"] < expected < shown["distance_upper"]
    assert len(vector.effort) == len(vector.name)
    status = bench.diagnosis(node)["charge"]
    assert status[1] == "state of charge received" and status[2]["projected"] == "False"


def test_the_range_is_that_of_the_route_whose_plan_was_asked(bench):
    node = bench.start(EnergyNode)
    bench.listen(topics.ENERGY_RANGE, *ANSWERS)
    drive(bench, node, range(211))  # 10 km are full
    motorway = ((0, 0, SPEED), (600, 30_000, SPEED), (1200, 60_000, SPEED))

    def ask_and_drive(frame, seconds):
        (answer,), _ = ask(bench, node, topics.SPEED_PROFILE, profile(*motorway, frame=frame))
        drive(bench, node, seconds)
        ranges = bench.heard[topics.ENERGY_RANGE]
        bench.pump(lambda: len(ranges) == node.published[topics.ENERGY_RANGE])
        return answer, values(ranges[-1])

    _, without = ask_and_drive("planner/one of several", range(211, 214))
    answer, along = ask_and_drive("the one that is driven", range(214, 217))
    needed = answer.points[-1].positions[0]
    left = node.account.route.left(node.account.odometer, 0)
    assert 60e3 - 4 * SPEED < left < 60e3
    after = (along["usable_energy"] - needed * left / 60e3) / (POWER / SPEED)
    assert along["distance_to_empty"] == pytest.approx(left + after, rel=0.01)
    assert along["distance_to_empty"] < 0.9 * without["distance_to_empty"]
    node.account.begin_next_trip()
    assert node.account.route is None


def test_a_path_without_times_begins_at_the_speed_of_the_car(bench):
    node, zero = bench.start(EnergyNode), np.zeros(2)
    bench.listen(*ANSWERS)
    for speed in (0.0, SPEED):
        (answer,), _ = ask(bench, node, topics.PLAN, path((0.0, 0.0, 0.0), (5e3, 0.0, 0.0)))
        plan = plan_from_path(np.array([0.0, 5e3]), zero, zero, start_speed=speed)
        last = answer.points[-1].time_from_start
        assert last.sec + last.nanosec / NANOSECONDS == pytest.approx(plan.time[-1], abs=1e-6)
        drive(bench, node, range(30))


@pytest.mark.parametrize("away", [4, 25])
def test_the_battery_is_counted_while_the_estimator_is_away(bench, monkeypatch, away):
    """As when it is killed, or started again: what it heard of nothing is missing."""
    node, now = bench.start(EnergyNode), [0.0]
    bench.listen(topics.ENERGY_STATE)
    now[0] = node.steady_s()
    monkeypatch.setattr(node, "steady_s", lambda: now[0])
    drive(bench, node, range(30))
    states = node.published[topics.ENERGY_STATE]
    for second in range(30, 30 + away):
        now[0] += 1.0
        bench.read(node, BatteryReading((START + second) * NANOSECONDS, 350.0, -POWER / 350.0))
    assert node.published[topics.ENERGY_STATE] > states
    drive(bench, node, range(30 + away, 60))
    state = node.account.state
    assert state.consumed == pytest.approx(59 * POWER) and state.unknown_s == 0.0
    assert state.consumed_sigma < 0.02 * 59 * POWER


@pytest.mark.parametrize("policy", ["reset", "hold"])
def test_of_two_publishers_an_hour_apart_one_is_followed_and_one_reported(bench, policy):
    node = bench.start(EnergyNode, time_jump_policy=policy)
    for turn in range(12):
        for offset in (0, -3600):
            drive(bench, node, range(offset + 3 * turn, offset + 3 * turn + 3))
    assert node.kept.guard.jumps <= 1
    level, text, shown = bench.diagnosis(node)["meter"]
    assert level is Level.WARN and "stamps_of_a_second_publisher" in text
    assert int(shown["bad.stamps_of_a_second_publisher"]) > 80
    driven = node.account.lifetime()
    assert driven.net.value == pytest.approx(35 * POWER, rel=0.15)
    assert driven.distance == pytest.approx(35 * SPEED, rel=0.15)


def test_hostile_speeds_and_powers_stop_nothing(bench, tmp_path):
    """They were added, saved and came back; four of them ended energy/state and every save."""
    file = tmp_path / "energy.json"
    node = bench.start(EnergyNode, energy_file=str(file))
    bench.listen(topics.ENERGY_STATE, *SUMMARY)
    drive(bench, node, range(10))
    for tick, wrong in enumerate(20 * [1e9, 1e308, -1e308]):
        stamp = (START + 10) * NANOSECONDS + tick * NANOSECONDS // 60
        bench.read(node, SpeedReading(stamp, wrong))
        for topic in (topics.POWER_MEASURED, topics.POWER_SMOOTHED):
            bench.deliver(node, topic, power(stamp, wrong))
    drive(bench, node, range(11, 31))
    bench.settle()
    assert values(bench.heard[topics.ENERGY_STATE][-1])["consumed"] == pytest.approx(
        30 * POWER, rel=0.05
    )
    consumption = values(bench.heard[topics.ENERGY_CONSUMPTION][-1])
    assert consumption["distance_lifetime"] <= 30 * SPEED
    shown = bench.diagnosis(node)["meter"][2]
    assert (shown["bad.speed_out_of_range"], shown["bad.power_out_of_range"]) == ("60", "120")
    assert bench.call(Trigger, "/ev/energy/save").success
    assert json.loads(file.read_text())["energy"]["trip"]["speed"]["drawn"] <= 30 * SPEED
