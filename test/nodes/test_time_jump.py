"""Time that jumps back, handled by policy."""

import pytest
from rosgraph_msgs.msg import Clock

from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS, SpeedReading
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode

S = NANOSECONDS


def efficiency(node):
    return node.estimator.parameters().parameters["eta"].value


@pytest.mark.parametrize("policy", ["hold", "ignore"])
def test_other_policies_keep_what_was_learned(bench, urban, policy):
    estimator = bench.start(EstimatorNode, time_jump_policy=policy)
    energy = bench.start(EnergyNode, time_jump_policy=policy)
    bench.listen(topics.POWER_SMOOTHED, topics.POWER_MEASURED)
    drive = [(topic, message) for topic, _, message in urban(8.0)]
    bench.drive(drive)
    bench.settle()
    energy.account.flush()
    learned, consumed = efficiency(estimator), energy.account.state.consumed
    smoothed = len(bench.heard[topics.POWER_SMOOTHED])
    bench.drive(drive[:20])
    bench.settle()
    again = len(bench.heard[topics.POWER_SMOOTHED]) - smoothed
    assert (again > 0) == (policy != "ignore")
    assert abs(energy.account.state.consumed - consumed) < 0.2 * abs(consumed)
    assert efficiency(estimator) == pytest.approx(learned, rel=0.02)


def test_a_clock_that_goes_back_needs_one_stamp_only(bench):
    node = bench.start(EstimatorNode, use_sim_time=True)
    clock = bench.node.create_publisher(Clock, "/clock", 1)
    bench.pump(lambda: clock.get_subscription_count() > 0)

    def tick(seconds):
        message = Clock()
        message.clock.sec = seconds
        clock.publish(message)
        bench.pump(lambda: node.now_ns() == seconds * S)

    def drive(seconds):
        bench.read(node, SpeedReading(round(seconds * S), 10.0))

    tick(1000)
    drive(1000.0)
    assert node.age(topics.SPEED) == 0.0
    tick(100)
    drive(100.0)
    assert node.kept.guard.jumps == 1
    assert node.estimator.status().newest_ns == 100 * S


def test_nothing_is_compared_across_a_jump(bench):
    """A bag that starts over while the car drove fast: its first speed of 0 is no leap."""
    node = bench.start(EstimatorNode, time_jump_policy="hold")
    for seconds, metres_per_second in ((100.0, 60.0), (100.1, 60.0), (80.0, 0.0), (80.1, 0.0)):
        bench.read(node, SpeedReading(round(seconds * S), metres_per_second))
    assert node.kept.guard.jumps == 1
    assert node._admission.refused == {}
