"""The example planner beside the real energy node: over topics alone, with it and without."""

import math

import pytest
from trajectory_msgs.msg import JointTrajectory

from evpinn_ros.core.energy.battery_model import BatteryModel
from evpinn_ros.core.energy.charge import UNKNOWN
from evpinn_ros.core.energy.forecaster import Forecaster
from evpinn_ros.core.energy.plan import COLUMNS, plan_from_speed_profile
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.parameters import overrides
from evpinn_ros.topics import NAMESPACE
from evpinn_ros.topics.plans import speed_profile_plan
from test.conftest import load_example
from test.waiting import HANG_S

VEHICLE = load_vehicle("tesla_model_3_lr")


EXAMPLE = load_example("eco_speed_planner.py")


@pytest.fixture
def start(bench):
    """Starts the example in the bench; gives the node and the plans it chooses."""
    started = []

    def make(**parameters):
        values = {"period": 0.5, "timeout": HANG_S if bench.nodes else 0.4, **parameters}
        options = {"namespace": NAMESPACE, "parameter_overrides": overrides(values)}
        node = EXAMPLE.EcoSpeedPlanner(**options)
        started.append(node)
        chosen = []
        bench.node.create_subscription(
            JointTrajectory, f"{NAMESPACE}/eco_speed_planner/chosen", chosen.append, 10
        )
        bench.executor.add_node(node)
        return node, chosen

    yield make
    for node in started:
        bench.executor.remove_node(node)
        node.destroy_node()


def start_energy(bench):
    """The energy node, which knows its battery: then each round ends with the last answer."""
    bench.read(bench.start(EnergyNode), BatteryReading(1, 350.0, -10.0, 0.8))


def plan_of(candidate):
    profile = (candidate.time, candidate.distance, candidate.speed, candidate.elevation)
    return plan_from_speed_profile(*profile)


def answered(planner):
    return not any(math.isnan(answer.energy) for answer in planner.answers)


@pytest.mark.parametrize("deadline", [560.0, 1000.0])
def test_it_picks_the_cheapest_of_those_in_time(bench, start, deadline):
    start_energy(bench)
    planner, chosen = start(deadline=deadline)
    bench.pump(lambda: answered(planner) and chosen)
    name = chosen[-1].header.frame_id
    library, charge = Forecaster(VEHICLE), BatteryModel(math.nan)
    expected = [
        library.answer(plan_of(candidate), UNKNOWN, UNKNOWN, 0, charge).forecast
        for candidate in planner.candidates
    ]
    for answer, result in zip(planner.answers, expected, strict=True):
        # Times cross DDS as whole nanoseconds.
        assert answer.energy == pytest.approx(result.energy[-1], rel=1e-6)
        assert answer.sigma == pytest.approx(result.sigma[-1], rel=1e-6)
    in_time = [
        (result.energy[-1], candidate.name)
        for candidate, result in zip(planner.candidates, expected, strict=True)
        if candidate.arrival <= deadline
    ]
    assert 1 < len(in_time) < len(planner.candidates)
    names = [candidate.name for candidate in planner.candidates]
    cheapest, pick = names.index(min(in_time)[1]), names.index(name)
    more, beside = EXAMPLE.difference(planner.answers, pick, cheapest)
    arrivals = [candidate.arrival for candidate in planner.candidates]
    assert pick == cheapest or (more < beside and arrivals[pick] < arrivals[cheapest])
    more, beside = EXAMPLE.difference(planner.answers, 0, cheapest)
    assert more == pytest.approx(expected[0].energy[-1] - expected[cheapest].energy[-1], rel=1e-6)
    alone = math.hypot(expected[0].sigma[-1], expected[cheapest].sigma[-1])
    assert cheapest == 0 or 0 < beside < 0.5 * alone, "what both share cancels"
    (candidate,) = [candidate for candidate in planner.candidates if candidate.name == name]
    plan, sent = speed_profile_plan(chosen[0]), plan_of(candidate)
    for field in COLUMNS:
        assert getattr(plan, field) == pytest.approx(getattr(sent, field), abs=1e-9)


def test_without_an_energy_node_it_says_so_and_goes_on(bench, start, capfd):
    planner, chosen = start()
    bench.pump(lambda: chosen)
    shown = capfd.readouterr()
    assert "no energy node listens to /ev/plan/speed_profile" in shown.err
    assert shown.out.count("no answer") >= len(planner.candidates)
    in_time = [candidate for candidate in planner.candidates if candidate.arrival <= 720.0]
    assert chosen[0].header.frame_id == max(in_time, key=lambda answer: answer.arrival).name
    start_energy(bench)
    planner._timeout.timer_period_ns = int(HANG_S * NANOSECONDS)
    bench.pump(lambda: answered(planner))
    chosen.clear()
    pick = EXAMPLE.cheapest_in_time(planner.candidates, planner.answers, 720.0)
    assert planner.answers[pick].energy < math.inf and planner.candidates[pick].arrival <= 720.0
    bench.pump(lambda: chosen and chosen[-1].header.frame_id == planner.candidates[pick].name)
