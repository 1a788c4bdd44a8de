"""Runs where `evpinn_msgs` is installed: typed and standard topics are equal, and the service."""

from array import array
import math
from pathlib import Path
import sys
import time

sys.path.insert(0, str(Path(__file__).parent))
import conftest
import numpy as np
import rclpy

from benchmarks.plan_load import speed_profile
from evpinn_msgs.msg import Plan
from evpinn_msgs.srv import EstimatePlan
from evpinn_ros import topics
from evpinn_ros.energy.plan import MAX_POINTS
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.plan_service import MOST_POINTS
from evpinn_ros.nodes.typed import RATE, SIGMA, TYPED, TYPED_FORECAST, quantities
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.topics.messages import named_vector

LONGEST_SILENCE = 0.6  # s of energy/state at 10 Hz, on busy cores

PAIRS = {**TYPED, topics.FORECAST: TYPED_FORECAST}


def same(one, other):
    return one == other or (math.isnan(one) and math.isnan(other))


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


def service(bench):
    asked = [plan("slow", 10.0), plan("back", 10.0, (0.0, 9.0, 1.0)), plan("fast", 20.0)]
    begin = time.monotonic()
    found = bench.call(EstimatePlan, "/ev/energy/estimate_plan", plans=asked)
    print(f"service {1e3 * (time.monotonic() - begin):.1f} ms")
    assert [bool(reason) for reason in found.refusals] == [False, True, False], found.refusals
    assert math.isnan(found.energies[1]) and "time" in found.refusals[1]
    more, sigma = found.differences[2 * 3 + 0], found.difference_sigmas[2 * 3 + 0]
    assert math.isclose(more, found.energies[2] - found.energies[0], rel_tol=1e-9)
    assert found.differences[0 * 3 + 2] == -more and found.differences[0] == 0.0
    assert 0 < sigma < math.hypot(found.sigmas[0], found.sigmas[2])
    assert math.isnan(found.differences[1])


def batch(plans, points):
    """A request of plans that are long."""
    time_s = np.arange(points, dtype=float)
    speed = 15.0 + 5.0 * np.sin(time_s / 30.0)
    numbers = {"time": time_s, "distance": np.cumsum(speed), "speed": speed}
    fields = {name: array("d", column.tobytes()) for name, column in numbers.items()}
    return EstimatePlan.Request(plans=[Plan(name=str(i), **fields) for i in range(plans)])


def energy_goes_on_beside_plans(bench, node):
    """Power comes at 10 Hz while a batch is answered; energy/state must go out at that rate."""
    client = bench.node.create_client(EstimatePlan, "/ev/energy/estimate_plan")
    bench.pump(client.service_is_ready)
    power, start, period = bench.publisher(topics.POWER_SMOOTHED), 2_000_000_000, 0.1
    request, moments = batch(60, 20_000), []
    future, due, count = client.call_async(request), time.monotonic(), node.published
    asked, before = due, count[topics.ENERGY_STATE]
    while not future.done():
        if time.monotonic() >= due:
            stamp = start * NANOSECONDS + round((due - asked) * NANOSECONDS)
            power.publish(named_vector(new_message, stamp, ["power"], [9e3], [90.0]))
            due += period
        bench.executor.spin_once(timeout_sec=0.01)
        if count[topics.ENERGY_STATE] > before:
            before = count[topics.ENERGY_STATE]
            moments.append(time.monotonic())
    took, silence = time.monotonic() - asked, np.diff([asked, *moments, time.monotonic()]).max()
    assert not any(future.result().refusals)
    print(f"60 plans in {took:.1f} s: {len(moments) / took:.1f} energy/state a second, ", end="")
    print(f"longest silence {silence:.2f} s")
    assert silence < LONGEST_SILENCE


def refusals(bench, node):
    """What is too much is refused, an inactive node answers nothing, and the car stays well."""
    name, call = "/ev/energy/estimate_plan", EstimatePlan
    plans = batch(1, MAX_POINTS).plans * (MOST_POINTS // MAX_POINTS + 1)
    node.active = False
    found = bench.call(call, name, plans=plans[:2])
    assert found.refusals == ["a managed node that is not active"] * 2
    assert all(map(math.isnan, found.energies)) and len(found.differences) == 4
    node.active = True
    found = bench.call(call, name, plans=plans)
    assert "points" in found.refusals[-1] and not any(found.refusals[:-1])
    said = bench.diagnosis(node)
    assert said["plan"][0].name == "OK" and int(said["plan"][2]["refused"]) >= 2
    assert int(said["meter"][2]["calls.~/estimate_plan"]) >= 3


def main():
    rclpy.init()
    bench = conftest.Bench()
    estimator = bench.start(EstimatorNode)
    energy = bench.start(EnergyNode)
    bench.listen(*PAIRS, *PAIRS.values())
    for topic, _, message in conftest._messages("urban", 12.0):
        bench.deliver(estimator, topic, message)
    bench.send(topics.SPEED_PROFILE, speed_profile(0, 60))
    bench.pump(lambda: bench.heard[topics.FORECAST])
    bench.settle()
    for topic, typed in PAIRS.items():
        heard, beside = bench.heard[topic], bench.heard[typed]
        bench.pump(lambda a=heard, b=beside: len(a) == len(b))
        if topic is not topics.ENERGY_RANGE:  # not known without a state of charge
            assert heard, topic.name
        for pair in zip(heard, beside, strict=True):
            compare(topic, *pair)
        print(topic.name, len(heard))
    service(bench)
    energy_goes_on_beside_plans(bench, energy)
    refusals(bench, energy)
    bench.close()
    rclpy.try_shutdown()


main()
