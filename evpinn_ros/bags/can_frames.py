"""Raw CAN frames as messages: `can_msgs/Frame`, as ros2_socketcan publishes and as we record.

Neither writing nor reading needs can_msgs to be installed: its one message is described in
`bags.types`.
"""

from __future__ import annotations

import struct

from evpinn_ros.bags.types import CDR_LITTLE_ENDIAN
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.topics import FRAME_TYPE

FRAMES_TOPIC = "can/frames"
"""Topic of a recording's raw frames, relative to the namespace."""

_CLASSIC = 8  # bytes of data that the message can hold

# Stamp, empty frame_id with its length and end, id, is_rtr, is_extended, is_error, dlc, data.
_CDR = struct.Struct("<4siII4xI???B8s")


def encode_frame(frame: CanFrame) -> bytes:
    """The CDR bytes of a frame as `can_msgs/Frame`; a struct, for thousands a second.

    Raises:
        ValueError: a CAN FD frame of more than 8 bytes, or a stamp outside ROS time.
    """
    seconds, nanoseconds = divmod(frame.stamp_ns, NANOSECONDS)
    if len(frame.data) > _CLASSIC or not 0 <= seconds < 2**31:
        raise ValueError(f"{FRAME_TYPE} cannot hold {frame}")
    header = (CDR_LITTLE_ENDIAN + b"\0\0", seconds, nanoseconds, 1)
    flags = (False, frame.extended, False)
    return _CDR.pack(*header, frame.can_id, *flags, len(frame.data), frame.data)
