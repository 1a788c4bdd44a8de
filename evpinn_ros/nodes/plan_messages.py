"""Conversion between plans, their energy forecasts and ROS 2 messages.

Readers raise `PlanError` with the reason when a message is no plan.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np

from evpinn_ros.energy.plan import (
    MAX_POINTS,
    NOMINAL_SPEED,
    Plan,
    PlanError,
    plan_from_path,
    plan_from_speed_profile,
)
from evpinn_ros.nodes.messages import NewMessage, finite, not_negative
from evpinn_ros.nodes.topics import TRAJECTORY_TYPE
from evpinn_ros.signals.readings import NANOSECONDS

MAX_BYTES = 160 * MAX_POINTS  # twice a pose with a short name of its frame
FORECAST_JOINT = "energy"
DISTANCE_JOINT = "distance"
ELEVATION_JOINT = "elevation"


def forecast_message(
    new: NewMessage,
    request_header: Any,
    times_ns: Sequence[int],
    energies: Sequence[float],
    powers: Sequence[float],
    sigmas: Sequence[float] | None = None,
) -> Any:
    """trajectory_msgs/JointTrajectory of the joint `energy`, the header of the plan echoed.

    Args:
        new: makes messages of the family of `request_header`.
        request_header: of the plan that is answered.
        times_ns: of each point since the start of the plan, not negative.
        energies: J since the start of the plan; drawn is positive.
        powers: W.
        sigmas: 1-sigma of the energies, J; None or NaN where unknown.
    """
    if sigmas is None:
        sigmas = [math.nan] * len(times_ns)
    points = [
        new(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=[finite(energy)],
            velocities=[finite(power)],
            effort=[] if math.isnan(sigma) else [not_negative(sigma)],
            time_from_start=duration_message(new, time_ns),
        )
        for time_ns, energy, power, sigma in zip(times_ns, energies, powers, sigmas, strict=True)
    ]
    return new(TRAJECTORY_TYPE, header=request_header, joint_names=[FORECAST_JOINT], points=points)


def refuse_long(size: int) -> None:
    """Refuse a serialised plan, of `size` bytes, that is not worth unpacking.

    Raises:
        PlanError: it holds more than `MAX_POINTS` points.
    """
    if size > MAX_BYTES:
        raise PlanError(f"{size / 1e6:.0f} MB are more than {MAX_POINTS} points")


def path_plan(message: Any, nominal_speed: float = NOMINAL_SPEED) -> Plan:
    """The plan in a nav_msgs/Path; without stamps on its poses it is driven at nominal speed.

    Raises:
        PlanError: the path cannot be driven.
    """
    positions = [pose.pose.position for pose in message.poses]
    x, y, z = (np.array([getattr(p, axis) for p in positions], dtype=float) for axis in "xyz")
    times = _seconds([pose.header.stamp for pose in message.poses])
    return plan_from_path(x, y, z, times, nominal_speed=nominal_speed)


def speed_profile_plan(message: Any) -> Plan:
    """The plan in a trajectory_msgs/JointTrajectory with the joint `distance`.

    A joint `elevation`, whose positions are m, may be given beside it; else the road is flat.

    Raises:
        PlanError: there is no such joint, a point lacks a number, or it cannot be driven.
    """
    names = list(message.joint_names)
    if DISTANCE_JOINT not in names:
        raise PlanError(f"no joint '{DISTANCE_JOINT}' in this profile")
    joint = names.index(DISTANCE_JOINT)
    points = message.points
    elevation = None
    if ELEVATION_JOINT in names:
        elevation = _column(points, "positions", names.index(ELEVATION_JOINT))
    return plan_from_speed_profile(
        _seconds([point.time_from_start for point in points]),
        _column(points, "positions", joint),
        _column(points, "velocities", joint),
        elevation,
    )


def duration_message(new: NewMessage, nanoseconds: int) -> Any:
    """builtin_interfaces/Duration."""
    seconds, rest = divmod(int(nanoseconds), NANOSECONDS)
    return new("builtin_interfaces/msg/Duration", sec=seconds, nanosec=rest)


def _column(points: Sequence[Any], field: str, joint: int) -> np.ndarray:
    for index, point in enumerate(points):
        if len(getattr(point, field)) <= joint:
            raise PlanError(f"{field} are missing at point {index}")
    return np.array([getattr(point, field)[joint] for point in points], dtype=float)


def _seconds(stamps: Sequence[Any]) -> np.ndarray:
    """Seconds since the first stamp; exact, where seconds since 1970 would be 240 ns coarse."""
    whole = np.array([int(s.sec) * NANOSECONDS + int(s.nanosec) for s in stamps], dtype=np.int64)
    return (whole - whole[:1]) / NANOSECONDS
