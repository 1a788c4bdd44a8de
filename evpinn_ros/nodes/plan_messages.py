"""Conversion between plans, their energy forecasts and ROS 2 messages."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

from evpinn_ros.nodes.messages import NewMessage, finite, not_negative
from evpinn_ros.nodes.topics import TRAJECTORY_TYPE
from evpinn_ros.signals.readings import NANOSECONDS

FORECAST_JOINT = "energy"


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
            time_from_start=_duration(new, time_ns),
        )
        for time_ns, energy, power, sigma in zip(times_ns, energies, powers, sigmas, strict=True)
    ]
    return new(TRAJECTORY_TYPE, header=request_header, joint_names=[FORECAST_JOINT], points=points)


def _duration(new: NewMessage, nanoseconds: int) -> Any:
    seconds, rest = divmod(int(nanoseconds), NANOSECONDS)
    return new("builtin_interfaces/msg/Duration", sec=seconds, nanosec=rest)
