"""Plans in messages of ROS 2, and their forecasts; readers raise `PlanError`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
import math
import struct
from typing import Any, TypeAlias

import numpy as np

from evpinn_ros.core.energy.path_plan import NOMINAL_SPEED, plan_from_path
from evpinn_ros.core.energy.plan import (
    CONDITION_RANGES,
    MAX_POINTS,
    Plan,
    PlanConditions,
    PlanError,
    Question,
    plan_from_speed_profile,
)
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.topics import AUTOWARE_TRAJECTORY_TYPE, PATH_TYPE, TRAJECTORY_TYPE
from evpinn_ros.topics.messages import BadMessage, NewMessage

FORECAST_JOINT = "energy"
DISTANCE_JOINT = "distance"
ELEVATION_JOINT = "elevation"
PLAN_TYPES = (PATH_TYPE, TRAJECTORY_TYPE, AUTOWARE_TRAJECTORY_TYPE)

Decode: TypeAlias = Callable[[str, bytes], Any]
"""Decodes CDR bytes to a message of this type; ValueError if they are none."""


def plan_of_message(
    type_name: str,
    data: bytes,
    decode: Decode,
    nominal_speed: float = NOMINAL_SPEED,
    start_speed: float = 0.0,
) -> Plan:
    """The plan in CDR bytes of one of `PLAN_TYPES`; PlanError if wrong or with too many points.

    A path without times is driven at `nominal_speed`, m/s, from `start_speed` on.
    """
    try:
        count = _point_count(type_name, data)
        if count < 2:
            raise PlanError(f"needs at least two points, not {count}")
        if count > MAX_POINTS:
            raise PlanError(f"{count} points are more than {MAX_POINTS}")
        message = decode(type_name, data)
    except PlanError:
        raise
    except (ValueError, struct.error) as error:
        raise PlanError("the message is damaged") from error
    if type_name == TRAJECTORY_TYPE:
        return speed_profile_plan(message)
    followed = (
        path_plan(message, nominal_speed, start_speed)
        if type_name == PATH_TYPE
        else trajectory_plan(message)
    )
    # A controller of Nav2 or Autoware follows it; without a map of heights its z is constant.
    return replace(followed, commanded=True, level=False)


def _point_count(type_name: str, data: bytes) -> int:
    """Number of points by the length field of a plan; struct.error if the bytes end before it."""
    order = "<" if data[1:2] == b"\1" else ">"

    def number(at: int) -> int:
        (value,) = struct.unpack_from(f"{order}I", data, at)
        return int(value)

    def behind_text(at: int) -> int:
        end = at + 4 + number(at)
        return end + -end % 4

    at = behind_text(12)  # the frame, after four bytes of encoding and eight of the stamp
    if type_name == TRAJECTORY_TYPE:  # skip the names of joints
        joints, at = number(at), at + 4
        for _ in range(joints):
            at = behind_text(at)
    return number(at)


def read_conditions(message: Any) -> PlanConditions:
    """Conditions of plans in a named vector, NaN as not given; BadMessage if wrong."""
    given = dict(zip(message.name, message.position, strict=False))
    if not len(given) == len(message.name) == len(message.position):
        raise BadMessage("lengths_differ")
    if not given.keys() <= CONDITION_RANGES.keys():
        raise BadMessage("unknown_name")
    try:
        return PlanConditions(**{k: float(v) for k, v in given.items() if not math.isnan(v)})
    except PlanError as error:
        raise BadMessage("out_of_range") from error


def forecast_message(
    new: NewMessage,
    header: Any,
    times: np.ndarray,
    energies: np.ndarray,
    powers: np.ndarray,
    sigmas: np.ndarray,
) -> Any:
    """trajectory_msgs/JointTrajectory of the joint `energy`, with the plan's header.

    Times, s, and energies, J, count from the start; powers are W, sigmas J; shape (n,) each.
    ValueError for a number that is not finite, and for a negative time or sigma.
    """
    whole = np.isfinite(np.stack((energies, powers, sigmas))).all()
    if not whole or (sigmas < 0).any() or not 0 <= times.min() <= times.max() < 2**31 - 1:
        raise ValueError("a forecast is not finite, or a sigma or a time negative")
    moments = np.divmod(np.rint(times * NANOSECONDS).astype(np.int64), NANOSECONDS)
    columns = (column.tolist() for column in (*moments, energies, powers, sigmas))
    points = [
        new(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=[energy],
            velocities=[power],
            effort=[sigma],
            time_from_start=new("builtin_interfaces/msg/Duration", sec=sec, nanosec=nanosec),
        )
        for sec, nanosec, energy, power, sigma in zip(*columns, strict=True)
    ]
    return new(TRAJECTORY_TYPE, header=header, joint_names=[FORECAST_JOINT], points=points)


def question(header: Any) -> Question:
    """The question of a plan: plans with one stamp and frame `asker/...` belong together."""
    asker, slash, _ = header.frame_id.rpartition("/")
    together = (header.stamp.sec, header.stamp.nanosec, asker) if slash else None
    return Question(header.frame_id, together)


def path_plan(message: Any, nominal_speed: float, start_speed: float) -> Plan:
    """The plan in a nav_msgs/Path, driven at these speeds, m/s, if its poses have no stamps."""
    x, y, z = _positions(message.poses)
    seconds = _seconds(pose.header.stamp for pose in message.poses)
    return plan_from_path(x, y, z, seconds, nominal_speed=nominal_speed, start_speed=start_speed)


def speed_profile_plan(message: Any) -> Plan:
    """The plan in a JointTrajectory of `distance`, perhaps `elevation`, m; or PlanError."""
    names, points = list(message.joint_names), message.points
    if DISTANCE_JOINT not in names:
        raise PlanError(f"no joint '{DISTANCE_JOINT}' in this profile")

    def column(field: str, joint: str) -> np.ndarray:
        index, rows = names.index(joint), [getattr(point, field) for point in points]
        for number, row in enumerate(rows, start=1):
            if len(row) <= index:
                raise PlanError(f"{field} are missing at point {number}")
        return np.array([row[index] for row in rows])

    distance, speed = column("positions", DISTANCE_JOINT), column("velocities", DISTANCE_JOINT)
    elevation = column("positions", ELEVATION_JOINT) if ELEVATION_JOINT in names else None
    seconds = _seconds(point.time_from_start for point in points)
    return plan_from_speed_profile(seconds, distance, speed, elevation)


def trajectory_plan(message: Any) -> Plan:
    """The plan in an autoware_planning_msgs/Trajectory; or PlanError.

    If its times do not rise, they are computed from its speeds, and the plan ends where it stops.
    """
    points = message.points
    x, y, z = _positions(points)
    speed = np.array([point.longitudinal_velocity_mps for point in points])
    with np.errstate(invalid="ignore", over="ignore"):  # the plan refuses such numbers
        legs = np.sqrt(sum(np.diff(axis) ** 2 for axis in (x, y, z)))
    distance = np.concatenate(([0.0], np.cumsum(legs)))
    seconds = _seconds(point.time_from_start for point in points)
    if not seconds.any():
        seconds, count = _seconds_of_speeds(distance, speed)
        distance, speed, z = distance[:count], speed[:count], z[:count]
    new = np.concatenate(([True], (np.diff(seconds) > 0) | (np.diff(distance) > 0)))
    return plan_from_speed_profile(seconds[new], distance[new], speed[new], z[new])


def _seconds_of_speeds(distance: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, int]:
    """Time, s, of each point until the car stops, and the number of these points."""
    stops = np.flatnonzero(speed[1:] == 0)
    count = stops[0] + 2 if stops.size else len(speed)
    length, twice_mean = np.diff(distance[:count]), speed[1:count] + speed[: count - 1]
    if count == 2 and not twice_mean.any():
        raise PlanError("its speeds are 0, and it has no times")
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.where(length > 0, 2.0 * length / twice_mean, 0.0)
    return np.concatenate(([0.0], np.cumsum(step))), count


def _positions(items: Sequence[Any]) -> np.ndarray:
    positions = (item.pose.position for item in items)
    return np.array([(position.x, position.y, position.z) for position in positions]).T


def _seconds(times: Iterable[Any]) -> np.ndarray:
    """Seconds since the first time, exactly: floats of seconds since 1970 resolve only 240 ns."""
    stamps = np.array([time.sec * NANOSECONDS + time.nanosec for time in times], np.int64)
    return (stamps - stamps[:1]) / NANOSECONDS
