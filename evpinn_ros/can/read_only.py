"""The only path for frames to the car: passes requests of the profile and their flow control."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
import time

from evpinn_ros.can.diagnostic_ids import FUNCTIONAL, refusal
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.request import QUESTIONS_PER_S, READ_SERVICES, RequestRule

FRAME_BYTES = 8
PADDING = b"\0"
"""Pads a frame to eight bytes, a length that every control unit accepts."""

FLOW_CONTROL = bytes((0x30, 0x00, 0x00))
"""Flow control: send all remaining frames without pauses (ISO 15765-2)."""

FRAMES_PER_S = 2 * QUESTIONS_PER_S
"""Frames that may be sent in any second: a request and its flow control. 50 frames are 1.2 % of a
bus of 500 kbit/s."""

FrameKey = tuple[int, bool, bytes]
"""Id, True if it has 29 bits, and data."""


class ReadOnlyGate:
    """Sends a frame only if it is a request of the profile, whichever code asks for it.

    After a request one flow control to the same control unit may follow, for a long answer: other
    senders of first frames get none.
    """

    def __init__(
        self,
        requests: Iterable[RequestRule],
        send: Callable[[CanFrame], bool],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Allow these requests; PermissionError if one does more than read."""
        self._send, self._clock = send, clock
        self._flow_controls = dict(map(frames_of, requests))
        self._awaited: set[FrameKey] = set()
        self._sent_s: deque[float] = deque(maxlen=FRAMES_PER_S)

    def __call__(self, frame: CanFrame) -> bool:
        """Send a frame, return the result of `send`; PermissionError if it is not allowed."""
        key = frame.can_id, frame.extended, bytes(frame.data)
        if key not in self._flow_controls and key not in self._awaited:
            raise PermissionError(f"{frame.can_id:X}: {frame.data.hex(' ')} is no read request")
        now_s = self._clock()
        if len(self._sent_s) == FRAMES_PER_S and now_s - self._sent_s[0] < 1.0:
            raise PermissionError(f"{frame.can_id:X}: more than {FRAMES_PER_S} frames in a second")
        self._sent_s.append(now_s)
        self._awaited.discard(key)
        if key in self._flow_controls and frame.can_id not in FUNCTIONAL:
            self._awaited.add(self._flow_controls[key])
        return self._send(frame)


def frames_of(request: RequestRule) -> tuple[FrameKey, FrameKey]:
    """Frame of a request, and its flow control; PermissionError if it does more than read."""
    address, payload = request.address, request.payload
    reason = refusal(address.tx_id, address.rx_id, address.target, address.source)
    if reason is None and len(payload) != 1 + READ_SERVICES.get(payload[0], -1):
        reason = f"{payload.hex(' ')} is no read request"
    if reason is not None:
        raise PermissionError(f"request '{request.name}': {reason}")
    parts = bytes((len(payload),)) + payload, FLOW_CONTROL
    question, flow_control = (
        (address.tx_id, address.extended, (address.prefix + part).ljust(FRAME_BYTES, PADDING))
        for part in parts
    )
    return question, flow_control
