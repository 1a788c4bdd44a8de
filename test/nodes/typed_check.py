"""Runs where `evpinn_msgs` is installed: typed and standard topics are equal, and the service."""

from array import array
from collections.abc import Iterator
from contextlib import contextmanager
import math
import sys
import threading
from unittest import mock

from action_msgs.msg import GoalStatus
import numpy as np
from rclpy.action import ActionClient

from benchmarks.plan_load import speed_profile
from evpinn_msgs.action import EstimatePlans
from evpinn_msgs.msg import Plan, PlanConditions
from evpinn_msgs.srv import EstimatePlan
from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes import energy
from evpinn_ros.nodes.base import NOT_ACTIVE
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.plan_answers import SERVICE, PlanCall
from evpinn_ros.nodes.typed import ALWAYS, RATE, SIGMA, TYPED, TYPED_FORECAST, quantities
from evpinn_ros.topics.messages import named_vector
from test.nodes import processes
from test.waiting import HANG_S

STATES = 20  # while a plan is answered

NOT_YET = {topics.ENERGY_RANGE}  # not known without a state of charge
PAIRS = {**TYPED, topics.FORECAST: TYPED_FORECAST}


def same(value, expected):
    return value == expected or (math.isnan(value) and math.isnan(expected))


def compare(topic, standard, typed):
    assert standard.header == typed.header, topic.name
    if topic is topics.FORECAST:
        rows = zip(
            standard.points, typed.time, typed.energy, typed.power, typed.sigma, strict=True
        )
        for point, _, *numbers in rows:
            assert [*point.positions, *point.velocities, *point.effort] == numbers
        return
    checked = set()
    for end, values in (
        ("", standard.position),
        (RATE, standard.velocity),
        (SIGMA, standard.effort),
    ):
        for name, value in zip(standard.name, values, strict=False):
            if f"{name}{end}" in quantities(typed):
                assert same(getattr(typed, f"{name}{end}"), value), (topic.name, name)
                checked.add(f"{name}{end}")
    for left in {*quantities(typed)} - checked:
        assert math.isnan(getattr(typed, left)), (topic.name, left)


def plan(name, speed, time_s=(0.0, 100.0, 200.0)):
    distance = [speed * t for t in time_s]
    return Plan(name=name, time=list(time_s), distance=distance, speed=[speed] * 3)


def by_action(bench, plans, **conditions):
    """Result of a goal of the action."""
    client = ActionClient(bench.node, EstimatePlans, "/ev/energy/estimate_plans")
    bench.pump(client.server_is_ready)
    goal = client.send_goal_async(EstimatePlans.Goal(plans=plans, **conditions))
    bench.pump(goal.done)
    response = goal.result().get_result_async()
    bench.pump(response.done)
    client.destroy()
    return response.result().result


def service(bench, node):
    known = named_vector(new_message, NANOSECONDS, ["payload"], [80.0])
    bench.deliver(node, topics.CONDITIONS, known)
    asked = [plan("slow", 10.0), plan("back", 10.0, (0.0, 9.0, 1.0)), plan("fast", 20.0)]
    answer = bench.call(EstimatePlan, "/ev/energy/estimate_plan", plans=asked)
    slow, back, fast = answer.results
    assert [result.name for result in answer.results] == ["slow", "back", "fast"]
    assert not slow.refusal and not fast.refusal and "time" in back.refusal
    assert math.isnan(back.energy) and all(map(math.isnan, back.more))
    assert math.isclose(fast.more[0], fast.energy - slow.energy, rel_tol=1e-9)
    assert slow.more[2] == -fast.more[0] and slow.more[0] == 0.0 and math.isnan(slow.more[1])
    assert 0 < fast.more_sigma[0] < math.hypot(slow.energy_sigma, fast.energy_sigma)
    assert answer.basis == "estimate/model" and answer.conditions == ["payload"]


def heights(bench, node):
    """A road of equal heights is level; one without may have hills."""
    unknown, level = plan("unknown", 10.0), plan("level", 10.0)
    level.elevation = [212.5] * 3
    answer = bench.call(EstimatePlan, "/ev/energy/estimate_plan", plans=[unknown, level])
    hilly, even = answer.results
    assert math.isclose(even.energy, hilly.energy, rel_tol=1e-9)
    assert 0.0 < even.energy_sigma < hilly.energy_sigma


def cuts(bench, node):
    """A plan with points between its points takes the same, by the service and by the action."""
    time_s = np.union1d([0.0, 100.0, 200.0], np.random.default_rng(1).uniform(0.0, 200.0, 40))
    speed, columns = 15.0, {"time": time_s.tolist(), "distance": (15.0 * time_s).tolist()}
    finer = Plan(name="finer", speed=[speed] * len(time_s), **columns)
    asked = [plan("whole", speed), finer]
    answer = bench.call(EstimatePlan, "/ev/energy/estimate_plan", plans=asked)
    for whole, cut in (answer.results, by_action(bench, asked).results):
        assert not whole.refusal and not cut.refusal
        assert math.isclose(cut.energy, whole.energy, rel_tol=1e-9)
        assert math.isclose(cut.energy_sigma, whole.energy_sigma, rel_tol=1e-9)
        assert abs(cut.more[0]) < 1e-9 * whole.energy


def conditions(bench, node):
    """Conditions of a call are those of `plan/conditions`, where both are given before them."""
    name, given = "/ev/energy/estimate_plan", {"temperature": -10.0, "payload": 200.0}

    def ask(**typed):
        asked = PlanConditions(**{field: [value] for field, value in typed.items()})
        return bench.call(EstimatePlan, name, plans=[plan("cold", 10.0)], conditions=asked)

    def tell(**vector):
        known = named_vector(new_message, NANOSECONDS, [*vector], [*vector.values()])
        bench.deliver(node, topics.CONDITIONS, known)

    def results(answer):
        assert not answer.results[0].refusal
        return answer.results[0].energy, answer.results[0].energy_sigma

    tell()
    plain, typed = ask(), ask(**given)
    tell(**given)
    vector, mixed = ask(), ask(temperature=15.0, heating=math.nan)
    assert results(typed) == results(vector) != results(plain)
    assert results(mixed) not in (results(plain), results(typed))
    for answer in (typed, vector, mixed):
        assert answer.conditions == ["temperature", "payload"]
    assert typed.assumed == vector.assumed and not plain.conditions
    assert [*typed.assumed.temperature, *typed.assumed.payload] == [-10.0, 200.0]
    assert [*mixed.assumed.temperature, *mixed.assumed.payload] == [15.0, 200.0]
    assert [*plain.assumed.payload, *plain.assumed.head_wind] == [0.0, 0.0]
    assert not plain.assumed.temperature and not plain.assumed.heating  # nobody knows them
    before, message = len(bench.heard[TYPED_FORECAST]), speed_profile(0, 60)
    bench.send(topics.SPEED_PROFILE, message)
    bench.pump(lambda: len(bench.heard[TYPED_FORECAST]) > before)
    over_topic = bench.heard[TYPED_FORECAST][-1]
    columns = zip(*((*p.positions, p.velocities[0]) for p in message.points), strict=True)
    same = dict(zip(("distance", "elevation", "speed"), map(list, columns), strict=True))
    asked = Plan(name="the same", time=[float(second) for second in range(60)], **same)
    (by_service,) = bench.call(EstimatePlan, name, plans=[asked]).results
    assert math.isclose(by_service.energy, over_topic.energy[-1], rel_tol=1e-9)
    assert math.isclose(by_service.energy_sigma, over_topic.sigma[-1], rel_tol=1e-9)
    assert over_topic.assumed == vector.assumed and over_topic.conditions == vector.conditions
    refusal = ask(temperature=300.0).results[0].refusal
    assert "temperature is 300" in refusal and len(ask(heating=-1.0).results[0].refusal) > 0
    tell()
    expected = PlanConditions(temperature=[-10.0], payload=[200.0])
    of_goal = by_action(bench, [plan("", 10.0)], conditions=expected)
    assert results(of_goal) == results(typed) and of_goal.assumed == typed.assumed


def batch(plans, points):
    """A request of plans that are long."""
    time_s = np.arange(points, dtype=float)
    speed = 15.0 + 5.0 * np.sin(time_s / 30.0)
    numbers = {"time": time_s, "distance": np.cumsum(speed), "speed": speed}
    fields = {name: array("d", column.tobytes()) for name, column in numbers.items()}
    return EstimatePlan.Request(plans=[Plan(name=str(i), **fields) for i in range(plans)])


@contextmanager
def held_before(number: int) -> Iterator[tuple[threading.Event, threading.Event]]:
    """Stops the thread that answers plans before this plan of a call.

    The first event is set when the thread has got there, the second lets it go on.
    """
    there, go_on, answer = threading.Event(), threading.Event(), PlanCall.answer

    def answer_later(call, *arguments):
        if len(call.results) == number:
            there.set()
            assert go_on.wait(HANG_S), "never let go on"
        answer(call, *arguments)

    with mock.patch.object(PlanCall, "answer", answer_later):
        yield there, go_on


def energy_goes_on_beside_plans(bench, node):
    """Each power gives its energy/state while plans are answered, not after them."""
    client = bench.node.create_client(EstimatePlan, "/ev/energy/estimate_plan")
    bench.pump(client.service_is_ready)
    start, states = 2_000_000_000, node.published

    def watts(second):
        stamp = (start + second) * NANOSECONDS
        return named_vector(new_message, stamp, ["power"], [9e3], [90.0])

    bench.deliver(node, topics.POWER_SMOOTHED, watts(0))  # it begins a new stretch of time
    with held_before(0) as (answering, go_on):
        future = client.call_async(batch(2, 100))
        bench.pump(answering.is_set)
        for second in range(1, STATES + 1):
            before = states[topics.ENERGY_STATE]
            bench.send(topics.POWER_SMOOTHED, watts(second))
            bench.pump(lambda n=before: states[topics.ENERGY_STATE] > n)
        assert not future.done()
        go_on.set()
        bench.pump(future.done)
    assert not any(result.refusal for result in future.result().results)


def batches(bench, node):
    """A goal of many plans tells how far it is, lets others in between, and can be cancelled."""
    client = ActionClient(bench.node, EstimatePlans, "/ev/energy/estimate_plans")
    between = bench.node.create_client(EstimatePlan, "/ev/energy/estimate_plan")
    bench.pump(lambda: client.server_is_ready() and between.service_is_ready())
    told, asked = [], batch(30, 200).plans

    def start(plans):
        goal = client.send_goal_async(
            EstimatePlans.Goal(plans=plans), lambda message: told.append(message.feedback)
        )
        bench.pump(goal.done)
        assert goal.result().accepted
        return goal.result()

    with held_before(29) as (_, go_on):
        whole = start(asked).get_result_async()
        bench.pump(lambda: told)
        single = between.call_async(EstimatePlan.Request(plans=asked[:1]))
        bench.pump(single.done)  # one plan need not wait for thirty
        assert not whole.done()
        go_on.set()
        bench.pump(whole.done)
    response = whole.result()
    assert response.status == GoalStatus.STATUS_SUCCEEDED and len(response.result.results) == 30
    energies = {result.energy for result in response.result.results}
    assert len(energies) == 1 and energies == {single.result().results[0].energy}
    assert response.result.results[29].more[3] == 0.0 and response.result.basis == "estimate/model"
    bench.pump(lambda: len(told) == 30)
    assert [feedback.done for feedback in told] == [*range(1, 31)]
    assert told[4].newest.name == "4" and math.isnan(told[4].newest.more[5])
    with held_before(10) as (there, go_on):
        goal = start(asked)
        bench.pump(there.is_set)
        bench.pump(goal.cancel_goal_async().done)
        go_on.set()
        rest = goal.get_result_async()
        bench.pump(rest.done)
    assert rest.result().status == GoalStatus.STATUS_CANCELED
    assert len(rest.result().result.results) == 11  # the one in work is not given up
    node.active = False
    refused = start(asked[:2]).get_result_async()
    bench.pump(refused.done)
    assert [result.refusal for result in refused.result().result.results] == [NOT_ACTIVE] * 2
    node.active = True
    client.destroy()


def refusals(bench, node):
    """What is too much is refused, an inactive node answers nothing, and the car stays well."""
    name, call = "/ev/energy/estimate_plan", EstimatePlan
    plans = batch(1, 200).plans * 3
    node.active = False
    answer = bench.call(call, name, plans=plans[:2])
    assert [result.refusal for result in answer.results] == [NOT_ACTIVE] * 2
    assert all(math.isnan(result.energy) and len(result.more) == 2 for result in answer.results)
    node.active = True
    with mock.patch.object(energy, "SERVICE", SERVICE._replace(points=2 * 200)):
        answer = bench.call(call, name, plans=plans)
    *answered, beyond = answer.results
    assert "points" in beyond.refusal and not any(plan_answer.refusal for plan_answer in answered)
    said = bench.diagnosis(node)
    assert said["plan"][0].name == "OK" and int(said["plan"][2]["refused"]) >= 2
    assert int(said["meter"][2]["calls.~/estimate_plan"]) >= 3


def test_a_fault_of_ours_refuses_each_plan_of_a_call(bench):
    node = bench.start(EnergyNode)
    bench.faulty.add(node)
    with mock.patch.object(PlanCall, "answer", lambda *_: 1 / 0):
        for plans in batch(1, 200).plans, batch(2, 200).plans, batch(1, energy.AT_ONCE + 1).plans:
            answer = bench.call(EstimatePlan, "/ev/energy/estimate_plan", plans=plans)
            reasons = [result.refusal for result in answer.results]
            assert reasons == ["internal fault: ZeroDivisionError"] * len(plans)
    assert node.health().faults == {"estimate_plan: ZeroDivisionError": 3}


def test_typed_and_standard_topics_are_equal_and_plans_are_compared(bench, urban):
    estimator = bench.start(EstimatorNode)
    node = bench.start(EnergyNode)
    bench.listen(*PAIRS, *PAIRS.values())
    bench.drive((topic, message) for topic, _, message in urban(15.0))
    bench.send(topics.SPEED_PROFILE, speed_profile(0, 60))
    bench.pump(lambda: bench.heard[topics.FORECAST])
    bench.settle()
    for topic, typed in PAIRS.items():
        heard, beside = bench.heard[topic], bench.heard[typed]
        bench.pump(lambda a=heard, b=beside: len(a) == len(b))
        if topic not in NOT_YET:
            assert heard, topic.name
        for pair in zip(heard, beside, strict=True):
            compare(topic, *pair)
    learned = (topics.MODEL, topics.IDENTIFIABLE)
    bench.pump(
        lambda: all(node.received[model] == estimator.published[model] for model in learned)
    )
    bench.stop(estimator)  # else it may tell a new model between two calls that are compared
    checks = service, heights, cuts, conditions, batches, energy_goes_on_beside_plans, refusals
    for check in checks:
        check(bench, node)


def test_named_vectors_may_be_left_out_but_for_those_between_the_nodes(bench, urban):
    nodes = [bench.start(kind, named_vectors=False) for kind in (EstimatorNode, EnergyNode)]
    bench.drive((topic, message) for topic, _, message in urban(15.0))
    published = {topic for node in nodes for topic, count in node.published.items() if count}
    assert published & TYPED.keys() == {*ALWAYS}
    assert {*TYPED.values()} - {TYPED[topic] for topic in NOT_YET} <= published
    assert {topics.ENERGY_CONSUMED, topics.ENERGY_TOTALS} <= published  # they have no typed form


def test_calls_are_answered_though_nothing_else_wakes_the_node(bench):
    """No input and no timer: what waits for the thread of the plans waits for it alone."""
    bare = "; ".join((
        "import sys",
        "from evpinn_ros import executables",
        "from evpinn_ros.nodes import base, keeper",
        "base.REPORT_PERIOD = keeper.SAVE_PERIOD = 1e6",
        "sys.exit(executables.energy())",
    ))  # fmt: skip
    command = [sys.executable, "-c", bare, *processes.node("energy")[3:]]
    plans = batch(20, 200).plans
    with processes.started(*command) as process:
        answer = bench.call(EstimatePlan, "/ev/energy/estimate_plan", plans=plans)
        assert not any(result.refusal for result in answer.results)
        of_goal = by_action(bench, plans)
        assert [r.name for r in of_goal.results] == [r.name for r in answer.results]
        assert not any(result.refusal for result in of_goal.results)
        processes.stopped(process)
