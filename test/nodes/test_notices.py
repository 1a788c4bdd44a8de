"""What a node says of its inputs beside its own verdict, over real DDS."""

import math

import rclpy

from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.topics import QUEUE_DEPTH
from evpinn_ros.topics.messages import Level
from evpinn_ros.topics.readings import speed_message
from test.nodes.conftest import SPIN
from test.nodes.plans import NOW
from test.waiting import wait_until


def speed(seconds):
    return speed_message(new_message, SpeedReading(NOW + round(seconds * NANOSECONDS), 10.0))


def test_values_that_are_no_numbers_are_named_and_are_no_arrival(bench, monkeypatch):
    node = bench.start(EstimatorNode)
    bench.deliver(node, topics.SPEED, speed(0.0))
    later = node.steady_s() + 5.0
    monkeypatch.setattr(node, "steady_s", lambda: later)
    for step in range(5):
        message = speed(1 + step / 10)
        message.twist.twist.linear.x = math.nan
        bench.deliver(node, topics.SPEED, message)
    level, text, values = bench.diagnosis(node)["estimate"]
    assert level is Level.WARN and "vehicle/speed: not_finite 5" in text
    assert values["bad.vehicle/speed: not_finite"] == "5"
    assert node.age(topics.SPEED) > 4.0


def test_an_imu_that_gives_no_orientation_is_told_once(bench, monkeypatch):
    """It never will; when it did meanwhile, or was away, it is told again."""
    node = bench.start(EstimatorNode)
    message = new_message(topics.IMU.type_name)
    message.orientation_covariance[0] = -1.0
    reported = []
    for later in (0.0, 5.0, 9.0, 14.0, 23.0, 100.0):
        monkeypatch.setattr(node, "steady_s", lambda later=later: later)
        bench.deliver(node, topics.IMU, message)
        reported.append("vehicle/imu: no_orientation" in bench.diagnosis(node)["estimate"][1])
    assert reported == [True, True, True, False, False, True]
    assert bench.diagnosis(node)["estimate"][2]["bad.vehicle/imu: no_orientation"] == "6"


def test_how_old_an_input_is_does_not_depend_on_how_the_clock_is_set(bench, monkeypatch):
    node = bench.start(EstimatorNode)
    bench.deliver(node, topics.SPEED, speed(0.0))
    for hours in (-3, 3):
        later = node.now_ns() + hours * 3600 * NANOSECONDS
        monkeypatch.setattr(node, "now_ns", lambda later=later: later)
        assert 0.0 <= node.age(topics.SPEED) < 60.0


def test_a_battery_that_falls_silent_brings_no_news_of_long_ago(bench, monkeypatch):
    """A topic of the state of charge alone, beside one that told power until now."""
    node = bench.start(EstimatorNode)
    for step in range(100):
        stamp_ns = NOW + step * NANOSECONDS // 10
        battery = BatteryReading(stamp_ns, 350.0, -20.0)
        charge = BatteryReading(stamp_ns, math.nan, math.nan, 0.5)
        for reading in (SpeedReading(stamp_ns, 10.0), battery, charge):
            node.estimator.add_readings([reading])
    for later in (0.0, 20.0, 21.0):
        monkeypatch.setattr(node, "steady_s", lambda later=later: later)
        last = SpeedReading(NOW + round((10 + later) * NANOSECONDS), 10.0)
        node.estimator.add_readings([last])
        (status,) = node.statuses()
    assert status.values["activity"] == "predicting"
    assert status.values["dropped.battery_unmeasured"] == 100
    assert "battery_unmeasured" not in status.text


def test_what_a_full_queue_dropped_is_counted_and_named(bench):
    """Taken by the executor alone, as in a car: the bench's `pump` takes messages itself."""
    node = bench.start(EstimatorNode)

    def take(count):
        wait_until(
            lambda: node.received[topics.SPEED] >= count or node.health().faults,
            meanwhile=lambda: bench.executor.spin_once(timeout_sec=SPIN),
        )

    bench.send(topics.SPEED, speed(0.0))
    take(1)
    for step in range(3 * QUEUE_DEPTH):
        bench.send(topics.SPEED, speed(step / 10))
    take(QUEUE_DEPTH + 1)
    lost = 2 * QUEUE_DEPTH
    assert node.bad["vehicle/speed: lost"] == lost
    assert f"vehicle/speed: lost {lost}" in bench.diagnosis(node)["estimate"][1]


def test_a_second_publisher_is_named_until_it_goes(bench):
    node = bench.start(EnergyNode)
    second = factory.advertise(bench.node, topics.SPEED)
    wanted = "2 publishers of vehicle/speed"

    def named():
        second.publish(speed(0.0))
        bench.post(node, topics.SPEED, speed(0.0))
        return wanted in bench.diagnosis(node)["meter"][1]

    bench.pump(named)
    bench.node.destroy_publisher(second)
    bench.pump(lambda: wanted not in bench.diagnosis(node)["meter"][1])


def test_a_quality_of_service_that_does_not_match_is_named_until_messages_come(bench):
    name = f"qos_overrides.{topics.SPEED.under()}.subscription.reliability"
    node = bench.start(EstimatorNode, **{name: "reliable"})
    kind = factory.message_class(topics.SPEED_TYPE)
    weak = factory.qos_profile(topics.SPEED.subscriber_qos)
    publisher = bench.node.create_publisher(kind, topics.SPEED.name, weak)
    wanted = "incompatible QoS of vehicle/speed: reliability"
    bench.pump(lambda: wanted in bench.diagnosis(node)["estimate"][1])
    assert node.why_silent(topics.SPEED) == (
        "1 publisher of vehicle/speed, incompatible QoS (reliability)"
    )
    bench.node.destroy_publisher(publisher)
    bench.deliver(node, topics.SPEED, speed(0.0))
    assert wanted not in bench.diagnosis(node)["estimate"][1]


def test_a_publisher_of_another_type_is_named(bench):
    """In a context of its own, for a process has one type for a topic."""
    node, others = bench.start(EstimatorNode), rclpy.Context()
    rclpy.init(context=others)
    other = rclpy.create_node("other", context=others)
    other.create_publisher(factory.message_class(topics.SCALAR_TYPE), topics.SPEED.under(), 10)
    wanted = "1 publisher of vehicle/speed, of type std_msgs/msg/Float64"
    bench.pump(lambda: node.why_silent(topics.SPEED) == wanted)
    other.destroy_node()
    rclpy.shutdown(context=others)


def test_who_publishes_a_speed_that_is_not_used_and_why_is_named_and_logged(bench, capfd):
    node, logged = bench.start(EstimatorNode), []
    waits = "waiting for vehicle/speed: "
    assert bench.diagnosis(node)["estimate"][1] == waits + "nobody publishes it"
    unset = speed(0.0)
    unset.header.stamp.sec = unset.header.stamp.nanosec = 0
    bench.post(node, topics.SPEED, unset)
    why = "1 publisher of vehicle/speed, no_stamp"
    assert bench.diagnosis(node)["estimate"][1].startswith(waits + why)

    def in_the_log():
        logged.append(capfd.readouterr().err)
        return waits + why in "".join(logged)

    bench.pump(in_the_log)
    bench.deliver(node, topics.SPEED, speed(0.0))
    assert "no_stamp" not in node.why_silent(topics.SPEED)
