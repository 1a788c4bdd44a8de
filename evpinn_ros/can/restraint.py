"""Decides when to pause and resume polling: a polled ECU stays awake and drains the 12 V battery.

A pause ends when the car moves, or its bus carries many ids again after a silence. Each time that
no answer follows, the next attempt is delayed longer, up to an hour. Without broadcasts a pause
lasts until the node restarts, because a probe can wake a car.
"""

from __future__ import annotations

from enum import Enum, auto
import math

from evpinn_ros.can.diagnostic_ids import is_request_id
from evpinn_ros.core.signals.readings import BatteryReading, Reading, SpeedReading

UNANSWERED_S = 30.0
"""Time without any answer after which the car counts as asleep."""

WOKEN_UNANSWERED_S = 5.0
"""The same after a pause: control units of a car that woke answer within a second."""

QUIET_S = 10.0
"""Silence of the whole bus after which traffic shows that the car woke."""

AWAKE_FRAMES, AWAKE_IDS, AWAKE_WITHIN_S = 20, 3, 2.0
"""Frames and ids, within a time, that show an awake car; stray frames or one control unit that
stays on send fewer. OVMS (vehicle_renaultzoe_ph2) takes 15 frames a second as an awake Zoe."""

FIRST_WAIT_S, LONGEST_WAIT_S = 60.0, 3600.0
"""Delay after an unanswered attempt before the next one, doubled each time."""

LOW_VOLTAGE, RECOVERED_VOLTAGE = 12.0, 12.5
"""V of a lead battery at rest, at 40 % and 80 % of charge; 13 V or more while charged."""
LOW_FOR_S = 10.0
DRIVING_FOR_S = 5.0
"""After a movement, time for which a low 12 V battery is accepted: the car charges it."""
STANDSTILL = 0.5  # m/s

IDLE_CURRENT = 0.3  # A: a car that is ready to drive, or charges, draws more
IDLE_FOR_S = 600.0


class Leave(Enum):
    """Requests that are allowed: all, the 12 V battery only, or none."""

    ALL = auto()
    AUXILIARY = auto()
    NOTHING = auto()


class Restraint:
    """Decides by frames and answers; all times in s of the monotonic clock."""

    def __init__(self) -> None:
        self.reason: str | None = None  # why requests are paused; None if they are not
        self.leave = Leave.ALL  # requests that are allowed
        self._low = False
        self._patience_s = UNANSWERED_S
        self._unanswered_since_s: float | None = None
        self._low_since_s: float | None = None
        self._idle_since_s: float | None = None
        self._moved_s = -math.inf
        self._traffic = _Traffic()
        self._wait_s = 0.0
        self._not_before_s = -math.inf

    def asked(self, now_s: float, sent: bool) -> None:
        """Note that a request was due; `sent` is False if there was no bus to send it on."""
        if self._low:
            self.leave = Leave.NOTHING
        elif not sent:
            self._unanswered_since_s = None
        elif self._unanswered_since_s is None:
            self._unanswered_since_s = now_s
        elif now_s - self._unanswered_since_s >= self._patience_s:
            self._stop(
                f"no answer for {self._patience_s:.0f} s: the car sleeps, or it is another car"
            )

    def answered(self) -> None:
        """Note an answer of a control unit, including a refusal."""
        self._unanswered_since_s = None
        if not self._low:
            self._patience_s, self._wait_s = UNANSWERED_S, 0.0

    def record_frame(self, can_id: int, extended: bool, now_s: float) -> bool:
        """Record a frame of any id; True if requests may be tried again."""
        self._traffic.record(can_id, extended, now_s)
        moves = now_s - self._moved_s < DRIVING_FOR_S
        awake = self._traffic.awake or moves
        if self.leave is not Leave.NOTHING or not awake or now_s < self._not_before_s:
            return False
        self._wait_s = min(max(2 * self._wait_s, FIRST_WAIT_S), LONGEST_WAIT_S)
        self._not_before_s = now_s + self._wait_s
        if self._low:
            self.leave = Leave.AUXILIARY
        else:
            self._resume(WOKEN_UNANSWERED_S)
        return True

    def observe(self, reading: Reading, now_s: float) -> None:
        """Note whether the car moves or draws current."""
        if isinstance(reading, SpeedReading) and abs(reading.speed) > STANDSTILL:
            self._moved_s = now_s
        elif isinstance(reading, BatteryReading):
            self._observe_current(reading.current, now_s)

    def auxiliary(self, voltage: float, now_s: float) -> None:
        """Note the voltage of the 12 V battery; a low one pauses all requests but its own."""
        if self._low:
            if voltage >= RECOVERED_VOLTAGE:
                self._low = False
                self._resume(UNANSWERED_S)
            return
        driving = now_s - self._moved_s < DRIVING_FOR_S
        if voltage >= LOW_VOLTAGE or driving:
            self._low_since_s = None
        elif self._low_since_s is None:
            self._low_since_s = now_s
        elif now_s - self._low_since_s >= LOW_FOR_S:
            self._low, self.reason = True, None
            self._stop(f"the 12 V battery is low: {voltage:.1f} V")

    def _observe_current(self, current: float, now_s: float) -> None:
        if math.isnan(current):
            return  # a reading of the voltage alone
        if abs(current) > IDLE_CURRENT:
            self._idle_since_s = None
        elif self._idle_since_s is None:
            self._idle_since_s = now_s
        elif now_s - self._idle_since_s >= IDLE_FOR_S:
            self._stop(f"no current for {IDLE_FOR_S / 60:.0f} min: requests keep the car awake")

    def _stop(self, reason: str) -> None:
        self.reason, self.leave = self.reason or reason, Leave.NOTHING
        self._traffic.awake = self._low  # traffic without an answer shows no awake car

    def _resume(self, patience_s: float) -> None:
        self.reason, self.leave, self._patience_s = None, Leave.ALL, patience_s
        self._unanswered_since_s = self._low_since_s = self._idle_since_s = None


class _Traffic:
    """Distinguishes the traffic of a car that woke from a stray frame."""

    def __init__(self) -> None:
        self.awake = False  # True if several ids came close together after a silence
        self._newest_s = -math.inf
        self._waking = False
        self._first_s = -math.inf
        self._frames = 0
        self._ids: set[int] = set()

    def record(self, can_id: int, extended: bool, now_s: float) -> None:
        """Record a frame, unless a tester sends on its id."""
        if is_request_id(can_id, extended):
            return
        if now_s - self._newest_s >= QUIET_S:
            self.awake, self._waking = False, True
        self._newest_s = now_s
        if not self._waking:
            return
        if now_s - self._first_s > AWAKE_WITHIN_S:
            self._first_s, self._frames = now_s, 0
            self._ids.clear()
        self._frames += 1
        self._ids.add(can_id)
        if self._frames >= AWAKE_FRAMES and len(self._ids) >= AWAKE_IDS:
            self.awake, self._waking = True, False
