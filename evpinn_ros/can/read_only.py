"""The one way out to the car: nothing passes but requests to read and their flow control."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.request import READ_SERVICES, Address

SINGLE_FRAME, FLOW_CONTROL = 0x0, 0x3
"""Kinds of ISO-TP frames (ISO 15765-2), the high half of the first byte."""


class ReadOnlyGate:
    """Hands a frame on when it can do no more than read, whatever made it."""

    def __init__(self, addresses: Iterable[Address], send: Callable[[CanFrame], bool]) -> None:
        """Open the gate to some control units; `send` puts a frame on the bus."""
        self._prefixes = {
            (address.tx_id, address.extended, address.prefix) for address in addresses
        }
        self._send = send

    def __call__(self, frame: CanFrame) -> bool:
        """Send the frame; gives what `send` does.

        Raises:
            PermissionError: the frame is neither a request to read nor flow control, or goes to
                a control unit that the profile does not ask.
        """
        if not any(
            (frame.can_id, frame.extended) == (can_id, extended)
            and frame.data.startswith(prefix)
            and _reads(frame.data[len(prefix) :])
            for can_id, extended, prefix in self._prefixes
        ):
            raise PermissionError(f"{frame.can_id:X}: {frame.data.hex(' ')} is no request to read")
        return self._send(frame)


def _reads(data: bytes) -> bool:
    """Whether ISO-TP bytes are one whole request of a service that reads, or flow control."""
    if len(data) < 2:
        return False
    kind, length = data[0] >> 4, data[0] & 0xF
    if kind == FLOW_CONTROL:
        return True
    if kind != SINGLE_FRAME or data[1] not in READ_SERVICES:
        return False
    return length == 1 + READ_SERVICES[data[1]] and length < len(data)
