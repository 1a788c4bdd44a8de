"""Plans and their energy forecasts as the bytes of ROS 2 messages (`cdr` says why bytes).

Readers raise `PlanError` with the reason when a message is no plan, `CdrError` when bytes are no
message.
"""

from __future__ import annotations

from collections.abc import Callable
import math
import struct
from typing import Any

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
from evpinn_ros.topics.cdr import ENCAPSULATION, CdrReader, cdr_text
from evpinn_ros.topics.messages import BadMessage, NewMessage

FORECAST_JOINT = "energy"
DISTANCE_JOINT = "distance"
ELEVATION_JOINT = "elevation"

# A point of a forecast from a multiple of 8 bytes on: of three sequences that hold one number
# each, and one that is empty.
_POINT = np.dtype(
    [
        ("has_position", "<u4"),
        ("before_position", "<u4"),
        ("position", "<f8"),
        ("has_velocity", "<u4"),
        ("before_velocity", "<u4"),
        ("velocity", "<f8"),
        ("no_acceleration", "<u4"),
        ("has_effort", "<u4"),
        ("effort", "<f8"),
        ("sec", "<i4"),
        ("nanosec", "<u4"),
    ]
)


def read_conditions(message: Any) -> PlanConditions:
    """Conditions of plans in a named vector; NaN is as good as no name.

    Raises:
        BadMessage: it names something else, or a number that no trip has.
    """
    given = dict(zip(message.name, message.position, strict=False))
    if not len(given) == len(message.name) == len(message.position):
        raise BadMessage("lengths_differ")
    if not given.keys() <= CONDITION_RANGES.keys():
        raise BadMessage("unknown_name")
    try:
        return PlanConditions(**{k: float(v) for k, v in given.items() if not math.isnan(v)})
    except PlanError as error:
        raise BadMessage("out_of_range") from error


def forecast_bytes(
    header: Any, times: np.ndarray, energies: np.ndarray, powers: np.ndarray, sigmas: np.ndarray
) -> bytes:
    """trajectory_msgs/JointTrajectory of the joint `energy`, the header of the plan echoed.

    Args:
        header: of the plan that is answered, std_msgs/Header.
        times: of each point since the start of the plan, s, shape (n,), not negative.
        energies: J since the start of the plan; drawn is positive.
        powers: W.
        sigmas: 1-sigma of the energies, J, not negative.

    Raises:
        ValueError: a number is not finite, or no such number.
    """
    whole = np.isfinite(np.stack((energies, powers, sigmas))).all()
    if not whole or (sigmas < 0).any() or not 0 <= times.min() <= times.max() < 2**31 - 1:
        raise ValueError("a forecast is not finite, or a sigma or a time negative")
    head = struct.pack("<iI", header.stamp.sec, header.stamp.nanosec) + cdr_text(header.frame_id)
    head += struct.pack("<I", 1) + cdr_text(FORECAST_JOINT) + struct.pack("<I", len(times))
    points = np.zeros(len(times), _POINT)
    for name in ("has_position", "has_velocity", "has_effort"):
        points[name] = 1
    points["position"], points["velocity"], points["effort"] = energies, powers, sigmas
    nanoseconds = np.rint(times * NANOSECONDS).astype(np.int64)
    points["sec"], points["nanosec"] = np.divmod(nanoseconds, NANOSECONDS)
    body = points.tobytes()
    if len(head) % 8:  # 4 bytes further on the first number needs none before it
        body = body[:4] + body[8:]
    return ENCAPSULATION + head + body


def request_header(new: NewMessage, data: bytes) -> Any:
    """std_msgs/Header, with which every plan begins."""
    reader = CdrReader(data)
    stamp = new("builtin_interfaces/msg/Time", sec=reader.number("i"), nanosec=reader.number())
    return new("std_msgs/msg/Header", stamp=stamp, frame_id=reader.text())


def question(header: Any) -> Question:
    """Question of a plan: plans of one stamp and `asker/...` as frame are asked together."""
    asker, slash, _ = header.frame_id.rpartition("/")
    together = (header.stamp.sec, header.stamp.nanosec, asker) if slash else None
    return Question(header.frame_id, together)


def path_plan(data: bytes, nominal_speed: float = NOMINAL_SPEED) -> Plan:
    """The plan in a nav_msgs/Path; without stamps on its poses it is driven at nominal speed.

    Raises:
        PlanError: the path cannot be driven.
        CdrError: the bytes are no path.
    """
    reader = _after_header(data)
    _, stamp, position = _points(reader, _walk_pose, 1).T
    x, y, z = (reader.numbers(position + 8 * axis, "f8") for axis in range(3))
    return plan_from_path(x, y, z, _seconds(reader, stamp), nominal_speed=nominal_speed)


def speed_profile_plan(data: bytes) -> Plan:
    """The plan in a trajectory_msgs/JointTrajectory with the joint `distance`.

    A joint `elevation`, whose positions are m, may be given beside it; else the road is flat.

    Raises:
        PlanError: there is no such joint, a point lacks a number, or it cannot be driven.
        CdrError: the bytes are no trajectory.
    """
    reader = _after_header(data)
    names = [reader.text() for _ in range(reader.number())]
    if DISTANCE_JOINT not in names:
        raise PlanError(f"no joint '{DISTANCE_JOINT}' in this profile")
    offsets = _points(reader, _walk_trajectory_point, 4)

    def column(field: str, joint: str) -> np.ndarray:
        length, first = offsets[:, _FIELDS[field]].T
        index = names.index(joint)
        short = np.flatnonzero(reader.numbers(length, "u4") <= index)
        if short.size:
            raise PlanError(f"{field} are missing at point {short[0]}")
        return reader.numbers(first + 8 * index, "f8")

    distance, speed = column("positions", DISTANCE_JOINT), column("velocities", DISTANCE_JOINT)
    elevation = column("positions", ELEVATION_JOINT) if ELEVATION_JOINT in names else None
    time = _seconds(reader, offsets[:, -1])
    return plan_from_speed_profile(time, distance, speed, elevation)


def trajectory_plan(data: bytes) -> Plan:
    """The plan in an autoware_planning_msgs/Trajectory.

    Where its times do not rise, as of planners that leave them out, they are those of its speeds;
    it then ends where it stops.

    Raises:
        PlanError: it cannot be driven, or backwards alone.
        CdrError: the bytes are no trajectory.
    """
    reader = _after_header(data)
    time, position, velocity = _points(reader, _walk_autoware_point, 0).T
    x, y, z = (reader.numbers(position + 8 * axis, "f8") for axis in range(3))
    speed = reader.numbers(velocity, "f4").astype(float)
    with np.errstate(invalid="ignore", over="ignore"):  # the plan refuses what is not finite
        legs = np.sqrt(sum(np.diff(axis) ** 2 for axis in (x, y, z)))
    distance = np.concatenate(([0.0], np.cumsum(legs)))
    seconds = _seconds(reader, time)
    if not seconds.any():
        seconds, count = _seconds_of_speeds(distance, speed)
        distance, speed, z = distance[:count], speed[:count], z[:count]
    new = np.concatenate(([True], (np.diff(seconds) > 0) | (np.diff(distance) > 0)))
    return plan_from_speed_profile(seconds[new], distance[new], speed[new], z[new])


def _seconds_of_speeds(distance: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, int]:
    """Seconds at which each point is passed until the car stops, and how many points that are."""
    stops = np.flatnonzero(speed[1:] == 0)
    count = stops[0] + 2 if stops.size else len(speed)
    length, twice_mean = np.diff(distance[:count]), speed[1:count] + speed[: count - 1]
    if count == 2 and not twice_mean.any():
        raise PlanError("it stands, and has no times")
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.where(length > 0, 2.0 * length / twice_mean, 0.0)
    return np.concatenate(([0.0], np.cumsum(step))), count


def _walk_autoware_point(reader: CdrReader) -> tuple[int, ...]:
    """Offsets of its time, of its position and of its speed."""
    time, position = reader.take(8, 4), reader.take(7 * 8, 8)
    return time, position, reader.take(6 * 4, 4)


_FIELDS = {"positions": [0, 4], "velocities": [1, 5]}  # of `_walk_trajectory_point`


def _walk_trajectory_point(reader: CdrReader) -> tuple[int, ...]:
    """Offsets of the lengths of its four sequences, of the numbers of each, and of its time."""
    lengths, numbers = zip(*(reader.sequence(8) for _ in range(4)), strict=True)
    return (*lengths, *numbers, reader.take(8, 4))


def _walk_pose(reader: CdrReader) -> tuple[int, ...]:
    """Offsets of the length of the name of its frame, of its stamp and of its position."""
    stamp = reader.take(8, 4)
    length, _ = reader.sequence(1)
    return length, stamp, reader.take(7 * 8, 8)


def _after_header(data: bytes) -> CdrReader:
    reader = CdrReader(data)
    reader.take(8, 4)
    reader.sequence(1)
    return reader


def _points(
    reader: CdrReader, walk: Callable[[CdrReader], tuple[int, ...]], lengths: int
) -> np.ndarray:
    """Offsets of what is in each point; refused before they are looked at when too many."""
    count = reader.number()
    if count < 2:
        raise PlanError(f"needs at least two points, not {count}")
    if count > MAX_POINTS:
        raise PlanError(f"{count} points are more than {MAX_POINTS}")
    return reader.elements(count, walk, lengths)


def _seconds(reader: CdrReader, offsets: np.ndarray) -> np.ndarray:
    """Seconds since the first time; exact, where seconds since 1970 would be 240 ns coarse."""
    # Widened first: before numpy 2 a scalar does not widen an array, and seconds overflow.
    whole = reader.numbers(offsets, "i4").astype(np.int64) * NANOSECONDS
    whole += reader.numbers(offsets + 4, "u4")
    return (whole - whole[:1]) / NANOSECONDS
