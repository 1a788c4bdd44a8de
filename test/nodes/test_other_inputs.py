"""Speed and attitude as others publish them: odometry, and IMUs in frames of their own."""

import math
import subprocess
import sys

import pytest

import evpinn_ros as ev
from evpinn_ros import topics
from evpinn_ros.bags.convert import BagReadings
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import new_message as bag_message
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.topics.messages import Level, header, read_named_vector, stamp_ns
from evpinn_ros.topics.readings import battery_message, rotation, speed_message

VEHICLE = "tesla_model_3_lr"
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
        bench.read(node, BatteryReading(stamp(tenth), 350.0, -30.0 + math.sin(tenth / 10)))
        speed = 10.0 + math.sin(tenth / 30)
        bench.deliver(node, topics.ODOMETRY, odometry(tenth, speed))
        if "frame" in also:
            bench.deliver(node, topics.IMU, imu(tenth, also["frame"], also["pitch"]))


def test_the_estimator_learns_from_odometry_alone(bench):
    node = bench.start(EstimatorNode)
    bench.listen(topics.POWER_PREDICTED, topics.DIAGNOSTICS)
    drive(bench, node, range(60))
    level, text, _ = bench.diagnosis(node)["estimate"]
    assert level is Level.OK and "learning" in text
    bench.settle()
    assert len(bench.heard[topics.POWER_PREDICTED]) > 50


def test_odometry_is_not_used_beside_vehicle_speed(bench):
    node = bench.start(EstimatorNode)
    bench.read(node, SpeedReading(stamp(0), 10.0))
    bench.deliver(node, topics.ODOMETRY, odometry(1, 99.0))
    _, text, values = bench.diagnosis(node)["estimate"]
    assert values["bad.odom: vehicle/speed is received"] == "1" and "not used" not in text


def test_an_imu_in_another_frame_gives_no_grade_and_says_why(bench):
    node = bench.start(EstimatorNode, grade_source="imu")
    drive(bench, node, range(20), frame="camera_imu", pitch=0.4)
    _, text, values = bench.diagnosis(node)["estimate"]
    why = "vehicle/imu: frame 'camera_imu' is not base_link: set imu_rotation_rpy"
    assert values[f"bad.{why}"] == "20" and f"not used from now on: {why}" in text
    assert "grade" in values["inputs_without_data"]


@pytest.mark.nightly
def test_a_replay_takes_the_mounting_of_the_imu_as_the_node_does(bench, bundled, tmp_path):
    """Node and `evpinn replay` of the bag it hears, equal within 1e-9; without it, a flat road."""
    node = bench.start(EstimatorNode, imu_rotation_rpy="0.0 0.4 0.0")
    bench.listen(topics.POWER_PREDICTED)
    with BagWriter(tmp_path / "drive") as bag:
        for index, (topic, message, sent) in enumerate(bundled("urban", 40.0)):
            if topic is topics.SPEED:
                attitude = mounted(index, stamp_ns(message))
                bag.write("/ev/vehicle/imu", attitude(bag_message), stamp_ns(message))
                bench.deliver(node, topics.IMU, attitude(new_message))
            bag.write(topic.under(), message, stamp_ns(message))
            bench.deliver(node, topic, sent)
    bench.settle()
    params = tmp_path / "node.yaml"
    params.write_text('/**/estimator:\n  ros__parameters: {imu_rotation_rpy: "0.0 0.4 0.0"}\n')
    live = [read_named_vector(m).values["power"] for m in bench.heard[topics.POWER_PREDICTED]]
    assert len(live) > 300
    assert powers(tmp_path, "--params", params) == pytest.approx(live, rel=1e-9)
    assert powers(tmp_path) != live


def mounted(index, stamp):
    """Makes the Imu of a car on hills; its frame is turned by 0.4 rad about the car's y axis."""
    attitude = rotation(0.0, 0.05 * math.sin(index / 50) + 0.4, 0.0)
    return lambda new: new(
        topics.IMU_TYPE,
        header=header(new, stamp, "camera_imu"),
        orientation=new("geometry_msgs/msg/Quaternion", **attitude._asdict()),
    )


def powers(folder, *options):
    """What `evpinn replay` of the bag predicts."""
    out = folder / f"out{len(options)}"
    words = ("replay", folder / "drive", "--vehicle", VEHICLE, "--out", out, *options)
    ended = subprocess.run(
        [sys.executable, "-m", "evpinn_ros", *map(str, words)], capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    assert ("frame 'camera_imu' is not base_link" in ended.stdout) == (not options)
    with BagReader(out) as bag:
        records = bag.records(["/ev/power/predicted"])
        return [read_named_vector(record.message).values["power"] for record in records]


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


@pytest.mark.parametrize("beside", [False, True])
def test_a_recorded_bag_of_autoware_replays_with_its_speed(tmp_path, beside):
    """Alone it is speed, and drives the odometer; beside odometry that is taken."""
    with BagWriter(tmp_path / "drive") as bag:
        for tenth in range(300):
            head = header(bag_message, stamp(tenth), "base_link")
            report = bag_message(
                topics.VELOCITY_REPORT_TYPE, header=head, longitudinal_velocity=8.0
            )
            bag.write("/vehicle/status/velocity_status", report, stamp(tenth))
            battery = BatteryReading(stamp(tenth), 350.0, -30.0)
            bag.write("/ev/battery/state", battery_message(bag_message, battery), stamp(tenth))
            if beside:
                bag.write("/odom", odometry(tenth, 7.0, bag_message), stamp(tenth))
    with BagReader(tmp_path / "drive") as bag:
        speeds = [r.speed for r in BagReadings(bag) if isinstance(r, SpeedReading)]
    assert speeds == 300 * [7.0 if beside else 8.0]
    car = ev.replay(tmp_path / "drive", vehicle=VEHICLE)
    assert car.metrics["breakdown"]["distance_m"] == pytest.approx(30 * speeds[0], rel=0.4)
