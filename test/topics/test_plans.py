"""Plans in the bytes of messages, as rosbags and rclpy read them, and forecasts."""

from contextlib import suppress
from functools import partial
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.api.plan import planned_energy
from evpinn_ros.bags.types import decode, encode, new_message, typestore
from evpinn_ros.core.energy.battery_model import BatteryModel
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.forecaster import Forecaster
from evpinn_ros.core.energy.plan import MAX_POINTS, PlanError, sums
from evpinn_ros.core.energy.remaining import Cost, Route, remaining
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.topics import AUTOWARE_TRAJECTORY_TYPE, PATH_TYPE, TRAJECTORY_TYPE
from evpinn_ros.topics.messages import header
from evpinn_ros.topics.plans import forecast_message, plan_of_message

NOW = 1_700_000_000_123_456_789
NAMES = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)
path_plan = partial(plan_of_message, PATH_TYPE, decode=decode)
speed_profile_plan = partial(plan_of_message, TRAJECTORY_TYPE, decode=decode)
FRAMES = st.sampled_from(["", "a", "map", "base", "base_", "odom_long"])


def path(frames, name="map", step_ns=2_500_000_000):
    """One pose in each frame, 25 m on and 1 m up each."""
    poses = [
        new_message(
            "geometry_msgs/msg/PoseStamped",
            header=header(new_message, NOW + i * step_ns, frame),
            pose=new_message(
                "geometry_msgs/msg/Pose",
                position=new_message("geometry_msgs/msg/Point", x=25.0 * i, y=-3.0, z=1.0 * i),
            ),
        )
        for i, frame in enumerate(frames)
    ]
    return new_message(PATH_TYPE, header=header(new_message, NOW, name), poses=poses)


def profile(points, name="map", joints=("distance", "elevation")):
    """Points of (accelerations, efforts), so many numbers each; 25 m on and 1 m up each."""
    return new_message(
        TRAJECTORY_TYPE,
        header=header(new_message, NOW, name),
        joint_names=list(joints),
        points=[
            new_message(
                "trajectory_msgs/msg/JointTrajectoryPoint",
                positions=[{"distance": 25.0, "elevation": 1.0}.get(j, 7.0) * i for j in joints],
                velocities=[10.0] * len(joints),
                accelerations=[0.5] * accelerations,
                effort=[0.5] * efforts,
                time_from_start=new_message(
                    "builtin_interfaces/msg/Duration",
                    sec=int(2.5 * i),
                    nanosec=500_000_000 * (i % 2),
                ),
            )
            for i, (accelerations, efforts) in enumerate(points)
        ],
    )


def check(plan, points):
    n = np.arange(points)
    assert plan.time == pytest.approx(2.5 * n, abs=0)
    assert plan.distance == pytest.approx(n * plan.distance[1], abs=1e-9)
    assert plan.elevation == pytest.approx(n, abs=0)
    assert np.all(plan.speed > 9.9)


@settings(deadline=None)
@given(st.lists(FRAMES, min_size=2, max_size=9), NAMES)
def test_a_path_is_read_whatever_its_frames_are_called(frames, name):
    check(path_plan(encode(path(frames, name))), len(frames))


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2)), min_size=2, max_size=9),
    st.permutations(["distance", "elevation", "wheel"]),
    NAMES,
)
def test_a_profile_is_read_whatever_else_its_points_hold(points, joints, name):
    check(speed_profile_plan(encode(profile(points, name, joints))), len(points))


def test_the_other_order_of_bytes():
    for kind, read, message in (
        (PATH_TYPE, path_plan, path(["a", "map", "map", "map"])),
        (TRAJECTORY_TYPE, speed_profile_plan, profile([(0, 0)] * 4)),
    ):
        data = bytes(typestore().serialize_cdr(message, kind, little_endian=False))
        assert data != encode(message)
        check(read(data), 4)


@pytest.mark.ros
def test_rclpy_reads_what_rosbags_reads():
    pytest.importorskip("rclpy.serialization")
    from evpinn_ros.nodes import factory

    for kind, message in (
        (PATH_TYPE, path(["map"] * 5)),
        (TRAJECTORY_TYPE, profile([(0, 1)] * 5)),
    ):
        data = encode(message)
        check(plan_of_message(kind, data, factory.decode), 5)
        assert factory.decode("std_msgs/msg/Header", data).stamp.nanosec == NOW % 10**9
        with pytest.raises(PlanError, match="damaged"):
            plan_of_message(kind, data[:-40], factory.decode)


def stamped(time, along, up):
    """A path straight on, its poses stamped, ns."""
    poses = [
        new_message(
            "geometry_msgs/msg/PoseStamped",
            header=header(new_message, NOW + t, "map"),
            pose=new_message(
                "geometry_msgs/msg/Pose",
                position=new_message("geometry_msgs/msg/Point", x=x, y=-3.0, z=z),
            ),
        )
        for t, x, z in zip(time.tolist(), along.tolist(), up.tolist(), strict=True)
    ]
    return new_message(PATH_TYPE, header=header(new_message, NOW, "map"), poses=poses)


def timed(time, *columns):
    """A profile of time, ns, distance, height and speed."""
    points = [
        new_message(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=[distance, height],
            velocities=[speed, 0.0],
            time_from_start=new_message(
                "builtin_interfaces/msg/Duration", sec=t // NANOSECONDS, nanosec=t % NANOSECONDS
            ),
        )
        for t, distance, height, speed in zip(
            time.tolist(), *(column.tolist() for column in columns), strict=True
        )
    ]
    names = ["distance", "elevation"]
    head = header(new_message, NOW, "map")
    return new_message(TRAJECTORY_TYPE, header=head, joint_names=names, points=points)


def trajectory(time, *columns):
    """A trajectory of Autoware: time, ns, distance, height and speed."""
    points = [
        new_message(
            "autoware_planning_msgs/msg/TrajectoryPoint",
            pose=new_message(
                "geometry_msgs/msg/Pose",
                position=new_message("geometry_msgs/msg/Point", x=x, y=-3.0, z=z),
            ),
            longitudinal_velocity_mps=speed,
            time_from_start=new_message(
                "builtin_interfaces/msg/Duration", sec=t // NANOSECONDS, nanosec=t % NANOSECONDS
            ),
        )
        for t, x, z, speed in zip(
            time.tolist(), *(column.tolist() for column in columns), strict=True
        )
    ]
    head = header(new_message, NOW, "map")
    return new_message(AUTOWARE_TRAJECTORY_TYPE, header=head, points=points)


@pytest.mark.parametrize("height", [0.0, 212.5])
@pytest.mark.parametrize(
    ("kind", "write", "level"),
    [
        (PATH_TYPE, lambda time, along, up, _: stamped(time, along, up), False),
        (PATH_TYPE, lambda time, along, up, _: stamped(0 * time, along, up), False),
        (AUTOWARE_TRAJECTORY_TYPE, trajectory, False),
        (AUTOWARE_TRAJECTORY_TYPE, lambda time, *columns: trajectory(0 * time, *columns), False),
        (TRAJECTORY_TYPE, lambda *_: profile([(0, 0)] * 4, joints=["distance"]), False),
        (TRAJECTORY_TYPE, timed, True),
    ],
)
def test_a_planner_in_two_dimensions_does_not_say_that_the_road_is_level(
    kind, write, level, height
):
    """Only a joint `elevation` does, whose numbers are all alike."""
    along = 250.0 * np.arange(4)
    columns = np.arange(4) * 25 * NANOSECONDS, along, np.full(4, height), np.full(4, 10.0)
    plan = plan_of_message(kind, encode(write(*columns)), decode)
    unseen = planned_energy(plan, "bmw_i3").energies.end.unseen
    assert unseen == pytest.approx(0.0 if level else plan.distance[-1], abs=0.0)
    assert plan.level == level


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", [PATH_TYPE, TRAJECTORY_TYPE])
def test_a_plan_cut_at_random_takes_the_same(kind, seed):
    """So the topic, the service and the action answer; and it is empty at the same place."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 7))
    corners = sums(rng.integers(30, 900, count)).astype(np.int64) * NANOSECONDS
    cuts = rng.integers(0, corners[-1], (1, 5, 60, 600)[seed])
    speed, slope = rng.uniform(4.0, 33.0, count + 1), rng.uniform(-0.04, 0.04, count)
    ends = sums((speed[1:] + speed[:-1]) / 2.0 * np.diff(corners) / NANOSECONDS)
    heights, level = sums(slope * np.diff(ends)), sums(np.sqrt(1.0 - slope**2) * np.diff(ends))
    forecaster, answers = Forecaster(load_vehicle("bmw_i3")), []
    for time in (corners, np.union1d(corners, cuts)):
        leg = np.clip(np.searchsorted(corners, time, "right") - 1, 0, count - 1)
        fast = np.interp(time, corners, speed)
        way = ends[leg] + (speed[leg] + fast) / 2.0 * (time - corners[leg]) / NANOSECONDS
        if kind == PATH_TYPE:
            message = stamped(time, *(np.interp(time, corners, at) for at in (level, heights)))
        else:
            message = timed(time, way, np.interp(way, ends, heights), fast)
        plan = plan_of_message(kind, encode(message), decode)
        assert len(plan.time) == len(time)
        charge, capacity = Uncertain(0.5, 0.01), Uncertain(40e6, 1e6)
        answer = forecaster.answer(plan, charge, capacity, 0, BatteryModel(40e6))
        result, curve = answer.forecast, answer.forecast.curve
        route = Route.from_here(curve, 0.0, 0).ahead(0.0, Cost(500.0, 500.0, 0.1))
        half = Uncertain(0.5 * float(curve.energy.max()), 1e5)
        ends_of = result.time[-1], result.energy[-1], result.sigma[-1], curve.distance[-1]
        answers.append([*ends_of, *answer.charge, answer.voltage, *remaining(half, route)])
    assert answers[1] == pytest.approx(answers[0], rel=1e-9, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize(
    ("data", "read"),
    [
        (encode(path(["a", "map", "map", "map"])), path_plan),
        (encode(path(["map"] * 4)), path_plan),
        (encode(profile([(0, 0), (1, 2), (0, 1)])), speed_profile_plan),
        (encode(profile([(0, 0)] * 4)), speed_profile_plan),
    ],
)
def test_a_message_cut_short_is_refused(data, read):
    """And so is one with a chance byte in it, unless it only says another plan."""
    needed = len(data) - 1
    while data[needed - 1 :].count(0) == len(data) - needed + 1:
        needed -= 1  # zeros of padding or of the last number
    for end in range(needed - 64):
        with pytest.raises(PlanError):
            read(data[:end])
    for at in range(len(data)):
        with suppress(PlanError):
            read(data[:at] + b"\xff" + data[at + 1 :])


def test_a_million_points_are_refused_without_being_looked_at():
    few, many = ((n).to_bytes(4, "little") for n in (3, 1_000_000))
    for data, read in (
        (encode(path(["map"] * 3)), path_plan),
        (encode(profile([(0, 0)] * 3)), speed_profile_plan),
    ):
        assert data.count(few) == 1
        with pytest.raises(PlanError, match=f"1000000 points are more than {MAX_POINTS}"):
            read(data.replace(few, many))


@settings(deadline=None)
@given(NAMES, st.integers(1, 9))
def test_a_forecast_is_the_message_with_these_numbers(name, points):
    times = 1.5 * np.arange(points)
    energy, power, sigma = times * 100, times + 7, times * 3
    request = header(new_message, NOW, name)
    message = forecast_message(new_message, request, times, energy, power, sigma)
    answer = decode(TRAJECTORY_TYPE, encode(message))
    assert answer.header == request and answer.joint_names == ["energy"]
    assert [list(p.positions) for p in answer.points] == energy[:, None].tolist()
    assert [list(p.velocities) for p in answer.points] == power[:, None].tolist()
    assert [list(p.effort) for p in answer.points] == sigma[:, None].tolist()
    assert all(len(p.accelerations) == 0 for p in answer.points)
    seconds = [p.time_from_start.sec + p.time_from_start.nanosec / 1e9 for p in answer.points]
    assert seconds == times.tolist()


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -1.0])
def test_a_forecast_that_is_none_is_not_written(wrong):
    request, fine = header(new_message, NOW), np.array([1.0, 2.0])
    with pytest.raises(ValueError):
        forecast_message(new_message, request, fine, fine, fine, np.array([1.0, wrong]))
    if wrong != -1.0:
        with pytest.raises(ValueError):
            forecast_message(new_message, request, fine, np.array([wrong, 0.0]), fine, fine)
