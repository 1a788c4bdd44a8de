"""ROS 2 messages and their CDR bytes without ROS: types of Jazzy, CAN adapters and Autoware."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
import struct
from textwrap import dedent
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from evpinn_ros.can.frame import CanFrame
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.topics import AUTOWARE_TRAJECTORY_TYPE, FRAME_TYPE, VELOCITY_REPORT_TYPE

FRAMES_TOPIC = "can/frames"
"""Topic of raw frames, as ros2_socketcan publishes them, relative to the namespace."""

CDR_BIG_ENDIAN, CDR_LITTLE_ENDIAN = b"\x00\x00", b"\x00\x01"

_OTHERS = {
    FRAME_TYPE: """
        std_msgs/Header header
        uint32 id
        bool is_rtr
        bool is_extended
        bool is_error
        uint8 dlc
        uint8[8] data
    """,
    VELOCITY_REPORT_TYPE: """
        std_msgs/Header header
        float32 longitudinal_velocity
        float32 lateral_velocity
        float32 heading_rate
    """,
    "autoware_planning_msgs/msg/TrajectoryPoint": """
        builtin_interfaces/Duration time_from_start
        geometry_msgs/Pose pose
        float32 longitudinal_velocity_mps
        float32 lateral_velocity_mps
        float32 acceleration_mps2
        float32 heading_rate_rps
        float32 front_wheel_angle_rad
        float32 rear_wheel_angle_rad
    """,
    AUTOWARE_TRAJECTORY_TYPE: """
        std_msgs/Header header
        autoware_planning_msgs/TrajectoryPoint[] points
    """,
}

CLASSIC = 8  # bytes of data that a `can_msgs/Frame` can hold

# Stamp, empty frame_id with its length and end, id, is_rtr, is_extended, is_error, dlc, data.
_FRAME = struct.Struct("<4siII4xI???B8s")


@cache
def typestore() -> Any:
    """The rosbags type store; made at first use, which takes a fraction of a second."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, fields in _OTHERS.items():
        store.register(get_types_from_msg(dedent(fields), name))
    return store


def new_message(type_name: str, /, **fields: Any) -> Any:
    """A message of `package/msg/Type`; fields not given are zero (also w), false or empty.

    KeyError: no such type. TypeError: no such field. ValueError: a fixed-size array of another
    size.
    """
    kind, makers = _layout(type_name)
    for name, make in makers.items():
        fields[name] = make(fields[name]) if name in fields else make(None)
    return kind(**fields)


def encode(message: Any) -> bytes:
    """The CDR bytes of a message made by `new_message` or by `decode`."""
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


def encode_frame(frame: CanFrame) -> bytes:
    """A frame as CDR of `can_msgs/Frame`; ValueError: over 8 bytes, or no ROS time."""
    seconds, nanoseconds = divmod(frame.stamp_ns, NANOSECONDS)
    if len(frame.data) > CLASSIC or not 0 <= seconds < 2**31:
        raise ValueError(f"{FRAME_TYPE} cannot hold {frame}")
    header = (CDR_LITTLE_ENDIAN + b"\0\0", seconds, nanoseconds, 1)
    flags = (False, frame.extended, False)
    return _FRAME.pack(*header, frame.can_id, *flags, len(frame.data), frame.data)


def decode(type_name: str, data: bytes) -> Any:
    """Decode CDR bytes; KeyError: unknown type, ValueError: not a message of this type.

    Bytes after the message are ignored: Fast DDS sends up to eight, and `deserialize_cdr` refuses
    more than three.
    """
    definition = typestore().get_msgdef(type_name)
    if data[:2] not in (CDR_BIG_ENDIAN, CDR_LITTLE_ENDIAN):
        raise ValueError("not CDR")
    little = data[:2] == CDR_LITTLE_ENDIAN
    read = definition.deserialize_cdr_le if little else definition.deserialize_cdr_be
    try:
        message, _ = read(memoryview(data)[4:], 0, definition.cls, typestore())
    except (struct.error, SerdeError) as error:
        raise ValueError(str(error)) from error
    return message


@cache
def _layout(type_name: str) -> tuple[type, dict[str, Callable[[Any], Any]]]:
    _, fields = typestore().fielddefs[type_name]
    return typestore().types[type_name], {name: _maker(what) for name, what in fields}


def _maker(description: Any) -> Callable[[Any], Any]:
    """Function that converts a given value, or None, to the value of a message field."""
    kind, detail = description
    if kind == Nodetype.NAME:
        return lambda given: new_message(detail) if given is None else given
    if kind == Nodetype.BASE:
        zero = _zero(detail[0])
        return lambda given: zero if given is None else given
    (item_kind, item), size = detail
    length = size if kind == Nodetype.ARRAY else 0
    if item_kind == Nodetype.BASE and item[0] not in ("string", "wstring"):
        dtype = np.dtype({"byte": "uint8", "char": "uint8"}.get(item[0], item[0]))
        return lambda given: _array(given, dtype, length)
    item_maker = _maker((item_kind, item))
    return lambda given: (
        [item_maker(None) for _ in range(length)] if given is None else list(given)
    )


def _zero(base: str) -> bool | int | float | str:
    if base == "bool":
        return False
    if base in ("string", "wstring"):
        return ""
    return 0.0 if base.startswith("float") else 0


def _array(given: Sequence[float] | None, dtype: np.dtype[Any], length: int) -> np.ndarray:
    if given is None:
        return np.zeros(length, dtype)
    array = np.array(given, dtype)
    if length and array.shape != (length,):
        raise ValueError(f"an array of {length} numbers was given {array.size}")
    return array
