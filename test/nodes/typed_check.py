"""Runs where `evpinn_msgs` is installed: typed and standard topics are equal, and the service."""

import math
from pathlib import Path
import sys
import time

sys.path.insert(0, str(Path(__file__).parent))
import conftest
import rclpy

from benchmarks.plan_load import speed_profile
from evpinn_msgs.msg import Plan
from evpinn_msgs.srv import EstimatePlan
from evpinn_ros import topics
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.typed import RATE, SIGMA, TYPED, TYPED_FORECAST, quantities

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


def main():
    rclpy.init()
    bench = conftest.Bench()
    estimator = bench.start(EstimatorNode)
    bench.start(EnergyNode)
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
    bench.close()
    rclpy.try_shutdown()


main()
