"""A mobile robot by odometry and battery alone: the nodes learn it, and answer Nav2's paths."""

import signal
import sys

import pytest

from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.topics import NAMESPACE
from evpinn_ros.topics.messages import header, read_named_vector
from evpinn_ros.topics.readings import speed_message
from test.nodes.plans import path
from test.nodes.processes import started, stopped
from test.robots import moments, robot

ROBOT = "mobile_robot"
START = 1_700_000_000 * NANOSECONDS


def odometry(stamp_ns, speed):
    twist = speed_message(new_message, SpeedReading(stamp_ns, speed)).twist
    head = header(new_message, stamp_ns, "odom")
    return new_message(topics.ODOMETRY_TYPE, header=head, child_frame_id="base_link", twist=twist)


def test_a_robot_is_learned_in_watts_and_its_path_costs_what_it_should(bench):
    estimator = bench.start(EstimatorNode, vehicle=ROBOT)
    energy = bench.start(EnergyNode, vehicle=ROBOT)
    bench.listen(topics.PARAMETERS, topics.FORECAST, topics.MODEL)
    for now in moments(1, 30.0):
        stamp = START + round(now.time * NANOSECONDS)
        if now.battery_due:
            bench.read(estimator, BatteryReading(stamp, now.voltage, -now.current, now.charge))
        bench.deliver(estimator, topics.ODOMETRY, odometry(stamp, now.speed))
    bench.settle()
    learned = read_named_vector(bench.heard[topics.PARAMETERS][-1])
    load = learned.values["p_aux"]
    assert load == pytest.approx(robot().COMPUTER, rel=0.4)
    before = energy.received[topics.MODEL]  # each of 10 s, so of less than all
    estimator.publish_model()
    bench.pump(lambda: energy.received[topics.MODEL] > before)
    bench.send(topics.PLAN, path((0.0, 0.0, 0.0), (50.0, 0.0, 0.0), (100.0, 0.0, 0.0)))
    bench.pump(lambda: bool(bench.heard[topics.FORECAST]))
    answer = bench.heard[topics.FORECAST][-1].points[-1]
    seconds = answer.time_from_start.sec + 1e-9 * answer.time_from_start.nanosec
    assert seconds == pytest.approx(101.0, abs=0.1)  # at the 1 m/s of the vehicle file
    forecast, sigma = answer.positions[0], answer.effort[0]
    assert load * seconds < forecast < 3.0 * load * seconds and 0.0 < sigma < 0.5 * forecast


def test_the_example_publishes_what_the_nodes_take(bench):
    estimator = bench.start(EstimatorNode, vehicle=ROBOT)
    command = (sys.executable, "examples/simulated_robot.py")
    with started(*command, "--ros-args", "-r", f"__ns:={NAMESPACE}") as robots:
        bench.listen(topics.POWER_PREDICTED)
        bench.pump(lambda: estimator.received[topics.BATTERY] > 5)
        bench.pump(lambda: len(bench.heard[topics.POWER_PREDICTED]) > 10)
        power = read_named_vector(bench.heard[topics.POWER_PREDICTED][-1]).values["power"]
        assert 0.0 < power < 500.0
        stopped(robots, signal.SIGTERM)
