"""Runs where messages of other stacks are built: CAN frames and Autoware."""

import time

import numpy as np

from evpinn_ros import topics
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.profile import load_profile
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.nodes.can_bridge import CanBridgeNode
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.frame_sources import frame_topic
from evpinn_ros.topics.messages import Level, header, stamp_ns
from evpinn_ros.topics.readings import battery_message, speed_message

START = 1_700_000_000 * NANOSECONDS


def stamp(tenth):
    return START + tenth * NANOSECONDS // 10


def frame(encoded, **flags):
    data = np.frombuffer(encoded.data.ljust(8, b"\0"), np.uint8)
    return new_message(
        "can_msgs/msg/Frame", header=header(new_message, encoded.stamp_ns, "can"),
        id=encoded.can_id, is_extended=encoded.extended, dlc=len(encoded.data), data=data, **flags,
    )  # fmt: skip


def test_can_frames(bench):
    """A bus that ros2_socketcan reads is decoded with the stamps of its frames."""
    node = bench.start(CanBridgeNode, interface="can_msgs", channel="from_can_bus")
    level, text, _ = bench.diagnosis(node)["bus"]
    assert level is Level.WARN and text == "no publisher of /ev/from_can_bus"
    bench.listen(topics.SPEED, topics.BATTERY)
    encoder, bus = Encoder(load_profile("tesla_model_3")), frame_topic("from_can_bus")
    count, sent = 0, []
    while not (bench.heard[topics.SPEED] and bench.heard[topics.BATTERY]):
        count += 1
        assert count < 3000
        sent.append(time.time_ns())
        battery = encoder.battery(BatteryReading(sent[-1], 350.0 + count % 5, -count % 50))
        speed = encoder.speed(SpeedReading(sent[-1], count % 20 / 10))
        for encoded in (battery, speed):
            bench.post(node, bus, frame(encoded))
    bench.post(node, bus, frame(speed, is_error=True))
    bench.post(node, bus, frame(speed, is_rtr=True))
    level, text, values = bench.diagnosis(node)["bus"]
    assert level is Level.OK and text == "receiving" and values["bus"] == "open", (text, values)
    assert values["bus.error_frames"] == values["bus.remote_frames"] == "1"
    assert {stamp_ns(message) for message in bench.heard[topics.SPEED]} <= {*sent}


def velocity(bench):
    """Speed of Autoware is learned from, until a better topic of it is received."""
    estimator, energy = bench.start(EstimatorNode), bench.start(EnergyNode)
    bench.listen(topics.POWER_PREDICTED)
    for tenth in range(60):
        reading = BatteryReading(stamp(tenth), 350.0, -30.0)
        battery = battery_message(new_message, reading)
        report = new_message(
            topics.VELOCITY_REPORT_TYPE,
            header=header(new_message, stamp(tenth), "base_link"),
            longitudinal_velocity=10.0,
        )
        bench.drive([(topics.BATTERY, battery), (topics.VELOCITY_REPORT, report)])
    energy.account.flush()
    assert 5.5 < energy.account.summary().since_reset.distance / 10.0 < 6.0
    bench.pump(lambda: len(bench.heard[topics.POWER_PREDICTED]) > 50)
    message = speed_message(new_message, SpeedReading(stamp(61), 10.0))
    bench.deliver(estimator, topics.SPEED, message)
    bench.deliver(estimator, topics.VELOCITY_REPORT, report)
    _, _, values = bench.diagnosis(estimator)["estimate"]
    why = "bad.vehicle/status/velocity_status: vehicle/speed is received"
    assert values[why] == "1"


def trajectory(speeds, times=None, step=10.0):
    """A straight road that climbs by one in a hundred, with these speeds at its points."""
    points = []
    for index, speed in enumerate(speeds):
        point = new_message(
            "autoware_planning_msgs/msg/TrajectoryPoint", longitudinal_velocity_mps=float(speed)
        )
        point.pose.position.x, point.pose.position.z = step * index, 0.01 * step * index
        if times is not None:
            point.time_from_start.sec = times[index]
        points.append(point)
    head = header(new_message, START, "map")
    return new_message(topics.AUTOWARE_TRAJECTORY_TYPE, header=head, points=points)


def plans(bench):
    """Trajectories with times and without cost the same; what stands for ever is refused."""
    bench.listen(topics.FORECAST, topics.FORECAST_STATUS)
    steady = [10.0] * 31
    asked = (
        trajectory(steady, times=[*range(31)]),
        trajectory(steady),
        trajectory([*steady, 5.0, 0.0, 0.0, 0.0]),
        trajectory([0.0] * 5),
    )
    for number, message in enumerate(asked, 1):
        bench.send(topics.TRAJECTORY, message)
        bench.pump(lambda n=number: len(bench.heard[topics.FORECAST_STATUS]) == n)
    with_times, without, stops = bench.heard[topics.FORECAST]
    assert with_times.header.frame_id == "map" and with_times.header.stamp.sec == START // 10**9
    for point, other in zip(with_times.points, without.points, strict=True):
        assert abs(point.positions[0] - other.positions[0]) <= 1e-3 * abs(point.positions[0]) + 1.0
    assert len(stops.points) == 33  # it ends where it stops
    refused = bench.heard[topics.FORECAST_STATUS][-1].status[0]
    assert "its speeds are 0, and it has no times" in refused.message


def test_velocity_and_plans(bench):
    velocity(bench)
    plans(bench)
