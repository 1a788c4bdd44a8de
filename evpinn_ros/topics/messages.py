"""Shared parts of the conversion between value types and ROS 2 messages, both ways.

Builders take `new`, which makes a message of any class family, so the same code serves rclpy and
bags (`evpinn_ros.bags.types.new_message`). They raise ValueError for a number that is not finite,
unless NaN has a meaning in the message. Readers raise `BadMessage` for a message without a usable
value.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
import math
from typing import Any, Protocol

from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS

VEHICLE_FRAME = "base_link"


class NewMessage(Protocol):
    """Makes a message: `new("std_msgs/msg/Header", frame_id="base_link")`; defaults otherwise."""

    def __call__(self, type_name: str, /, **fields: Any) -> Any:
        """A message of the type `package/msg/Type`."""


class BadMessage(ValueError):  # noqa: N818  (it is the message that is bad)
    """A message holds no usable value."""

    def __init__(self, reason: str, *, usual: bool = False, lasting: bool = False) -> None:
        super().__init__(reason)
        self.reason = reason  # a short snake_case key for counters
        self.usual = usual  # True if nothing is wrong, as when GNSS has no fix in a garage
        self.lasting = lasting  # True if every message of this source is bad


class Level(IntEnum):
    """Level of a diagnostic status."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class NamedVector:
    """Named quantities of one moment; `sigmas` and `rates` are empty if not given."""

    stamp_ns: int
    values: Mapping[str, float]
    sigmas: Mapping[str, float]
    rates: Mapping[str, float]


# --- builders ----------------------------------------------------------------------------------


def header(new: NewMessage, stamp_ns: int, frame_id: str = "") -> Any:
    """std_msgs/Header; ValueError for a stamp outside 1970 to 2038, which ROS time holds."""
    message = new("std_msgs/msg/Header", frame_id=frame_id)
    _set_stamp(message, stamp_ns)
    return message


def _set_stamp(header: Any, stamp_ns: int) -> None:
    seconds, nanoseconds = divmod(stamp_ns, NANOSECONDS)
    if not 0 <= seconds < 2**31:
        raise ValueError(f"{stamp_ns} ns is outside ROS time")
    header.stamp.sec, header.stamp.nanosec = seconds, nanoseconds


def scalar(new: NewMessage, value: float) -> Any:
    """A std_msgs/Float64; ValueError if it is not finite."""
    return new(topics.SCALAR_TYPE, data=finite(value))


def named_vector(
    new: NewMessage,
    stamp_ns: int,
    names: Sequence[str],
    values: Sequence[float],
    sigmas: Sequence[float] | None = None,
    rates: Sequence[float] | None = None,
) -> Any:
    """sensor_msgs/JointState: value, rate and 1-sigma as position, velocity and effort.

    Effort stays empty if a sigma is NaN (unknown). ValueError: lengths differ, a number is not
    finite, or a sigma is negative.
    """
    rates = [] if rates is None else rates
    if sigmas is None or any(map(math.isnan, sigmas)):
        sigmas = []
    if {len(names)} != {len(values), len(rates) or len(names), len(sigmas) or len(names)}:
        raise ValueError(f"{len(names)} names do not fit the values, sigmas or rates")
    if not all(map(math.isfinite, (*values, *rates, *sigmas))) or min(sigmas, default=0.0) < 0.0:
        raise ValueError(f"not finite, or a negative sigma: {values}, {rates}, {sigmas}")
    message = new(
        topics.NAMED_VECTOR_TYPE,
        name=list(names),
        position=list(map(float, values)),
        velocity=list(map(float, rates)),
        effort=list(map(float, sigmas)),
    )
    _set_stamp(message.header, stamp_ns)  # a new header costs as much as the message
    return message


def diagnostics(
    new: NewMessage,
    stamp_ns: int,
    statuses: Iterable[tuple[str, Level, str, Mapping[str, object]]],
    hardware: str = "",
) -> Any:
    """diagnostic_msgs/DiagnosticArray from tuples (name, level, message, {key: value})."""
    rows = []
    for name, level, message, values in statuses:
        pairs = [
            new("diagnostic_msgs/msg/KeyValue", key=key, value=str(value))
            for key, value in values.items()
        ]
        kind = "diagnostic_msgs/msg/DiagnosticStatus"
        status = new(kind, hardware_id=hardware, name=name, message=message, values=pairs)
        # rclpy stores a byte as bytes, rosbags as int: the constant of the class suits both.
        status.level = getattr(type(status), Level(level).name)
        rows.append(status)
    return new(topics.DIAGNOSTICS_TYPE, header=header(new, stamp_ns), status=rows)


def finite(value: float) -> float:
    """The value; ValueError if it is not finite."""
    if not math.isfinite(value):
        raise ValueError(f"{value} is not finite")
    return float(value)


def not_negative(value: float) -> float:
    """The value of a variance or a sigma; ValueError if negative or not finite."""
    if not 0 <= value < math.inf:
        raise ValueError(f"{value} is no variance or sigma")
    return float(value)


# --- readers -----------------------------------------------------------------------------------


def stamp_ns(message: Any) -> int:
    """The header stamp, ns; BadMessage("no_stamp") if it is zero, so was never set."""
    stamp = message.header.stamp
    nanoseconds = int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)
    if nanoseconds <= 0:
        raise BadMessage("no_stamp")
    return nanoseconds


def read_named_vector(message: Any) -> NamedVector:
    """The named vector in a JointState; BadMessage: lengths differ, or a number is not finite."""
    names = message.name
    values, rates = _by_name(names, message.position), _by_name(names, message.velocity)
    sigmas = _by_name(names, message.effort)
    if len(values) != len(names):
        raise BadMessage("lengths_differ")
    return NamedVector(stamp_ns(message), values, sigmas, rates)


def _by_name(names: Sequence[str], numbers: Sequence[float]) -> dict[str, float]:
    if not len(numbers):
        return {}
    by_name = dict(zip(names, map(float, numbers), strict=False))
    if not len(names) == len(numbers) == len(by_name):
        raise BadMessage("lengths_differ")
    if not all(map(math.isfinite, by_name.values())):
        raise BadMessage("not_finite")
    return by_name


def usable(value: float) -> float:
    """A number of a message; BadMessage("not_finite") if it is not finite."""
    if not math.isfinite(value):
        raise BadMessage("not_finite")
    return float(value)
