"""Speed and attitude as others publish them: odometry, and IMUs in frames of their own."""

import math

import pytest

from evpinn_ros.bags.convert import BagReadings
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import new_message as bag_message
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.nodes import topics
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.messages import Level, battery_message, header, speed_message
from evpinn_ros.nodes.reading_messages import rotation
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, SpeedReading

START = 1_700_000_000 * NANOSECONDS


def stamp(tenth):
    return START + tenth * NANOSECONDS // 10


def odometry(tenth, speed, new=new_message):
    twist = speed_message(new, SpeedReading(stamp(tenth), speed)).twist
    head = header(new, stamp(tenth), "odom")
    return new(topics.ODOMETRY_TYPE, header=head, child_frame_id="base_link", twist=twist)


def imu(tenth, frame, pitch):
    q = rotation(0.0, pitch, 0.0)
    return new_message(
        topics.IMU_TYPE,
        header=header(new_message, stamp(tenth), frame),
        orientation=new_message("geometry_msgs/msg/Quaternion", **q._asdict()),
    )


def drive(bench, node, tenths, **also):
    for tenth in tenths:
        reading = BatteryReading(stamp(tenth), 350.0, -30.0 + math.sin(tenth / 10))
        if also.get("battery", True):
            bench.deliver(node, topics.BATTERY, battery_message(new_message, reading))
        speed = 10.0 + math.sin(tenth / 30)
        bench.deliver(node, topics.ODOMETRY, odometry(tenth, speed))
        if "frame" in also:
            bench.deliver(node, topics.IMU, imu(tenth, also["frame"], also["pitch"]))


def test_the_estimator_learns_from_odometry_alone(bench):
    node = bench.start(EstimatorNode)
    bench.listen(topics.POWER_PREDICTED, topics.DIAGNOSTICS)
    drive(bench, node, range(60))
    bench.settle()
    assert len(bench.heard[topics.POWER_PREDICTED]) > 50
    level, text, _ = bench.diagnosis(node)["estimate"]
    assert level is Level.OK and "learning" in text


def test_odometry_is_not_used_beside_vehicle_speed(bench):
    node = bench.start(EstimatorNode)
    message = speed_message(new_message, SpeedReading(stamp(0), 10.0))
    bench.deliver(node, topics.SPEED, message)
    bench.deliver(node, topics.ODOMETRY, odometry(1, 99.0))
    _, text, values = bench.diagnosis(node)["estimate"]
    assert values["bad.odom: vehicle/speed is received"] == "1" and "not used" not in text


def test_the_distance_driven_comes_from_odometry_too(bench):
    node = bench.start(EnergyNode)
    for tenth in range(30):
        bench.deliver(node, topics.ODOMETRY, odometry(tenth, 10.0))
    assert node.account.summary().since_reset.distance == pytest.approx(29.0)


def test_an_imu_in_another_frame_gives_no_grade_and_says_why(bench):
    node = bench.start(EstimatorNode, grade_source="imu")
    drive(bench, node, range(20), frame="camera_imu", pitch=0.4)
    _, text, values = bench.diagnosis(node)["estimate"]
    why = "vehicle/imu: frame 'camera_imu' is not base_link: set imu_rotation_rpy"
    assert values[f"bad.{why}"] == "20" and f"not used from now on: {why}" in text
    assert "grade" in values["not_told"]


def test_an_imu_of_known_mounting_gives_the_grade(bench):
    options = {"grade_source": "imu", "imu_rotation_rpy": "0 0.4 0"}
    node = bench.start(EstimatorNode, **options)
    drive(bench, node, range(30), frame="camera_imu", pitch=0.35)
    _, text, values = bench.diagnosis(node)["estimate"]
    assert "imu" not in text and "grade" not in values["not_told"]


def test_a_bag_with_odometry_alone_has_a_speed(tmp_path):
    for name, both in (("odometry", False), ("both", True)):
        with BagWriter(tmp_path / name) as bag:
            for tenth in range(10):
                message = odometry(tenth, 7.0, bag_message)
                bag.write("/robot1/odom", message, stamp(tenth))
                if both:
                    reading = SpeedReading(stamp(tenth), 8.0)
                    bag.write(
                        "/ev/vehicle/speed", speed_message(bag_message, reading), stamp(tenth)
                    )
        with BagReader(tmp_path / name) as bag:
            speeds = [reading.speed for reading in BagReadings(bag)]
        assert speeds == 10 * [8.0 if both else 7.0]
