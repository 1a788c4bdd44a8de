"""Decides when to pause and resume polling: a polled ECU stays awake and drains the 12 V battery.

A pause ends when the car moves, or its bus carries many ids again after a silence. Each time that
no answer followed, the next is accepted later, up to an hour. Where nothing is broadcast, a pause
lasts until the node restarts: a probe can wake a car.
"""

from __future__ import annotations

from enum import Enum, auto
import math

from evpinn_ros.can.diagnostic_ids import is_request_id
from evpinn_ros.core.signals.readings import BatteryReading, Reading, SpeedReading

UNANSWERED_S = 30.0
"""Pause of every control unit after which the car is taken to be asleep."""

WOKEN_UNANSWERED_S = 5.0
"""Pause of every control unit after a stop: those of a car that woke answer in a second."""

QUIET_S = 10.0
"""Pause of the whole bus after which its traffic can show that the car woke."""

AWAKE_FRAMES, AWAKE_IDS, AWAKE_WITHIN_S = 20, 3, 2.0
"""Traffic of a car that is awake: a stray frame or one restless control unit makes less. OVMS
(vehicle_renaultzoe_ph2) takes 15 frames a second of a few ids for an awake Zoe."""

FIRST_WAIT_S, LONGEST_WAIT_S = 60.0, 3600.0
"""Time from one awakening that came to nothing to the next that is accepted, doubled each time."""

LOW_VOLTAGE, RECOVERED_VOLTAGE = 12.0, 12.5
"""V of a lead battery at rest, charged to 40 % and 80 %; 13 and more while the car charges it."""
LOW_FOR_S = 10.0
DRIVING_FOR_S = 5.0
"""The 12 V battery may be low while driving: the car charges it."""
STANDSTILL = 0.5  # m/s

IDLE_CURRENT = 0.3  # A: a car that is ready to drive, or charges, draws more
IDLE_FOR_S = 600.0


class Leave(Enum):
    """Leave to ask: everything, the 12 V battery alone, nothing."""

    ALL = auto()
    AUXILIARY = auto()
    NOTHING = auto()


class Restraint:
    """Watches what comes back; all times in s of the monotonic clock."""

    def __init__(self) -> None:
        self.reason: str | None = None  # why not to ask, None while asking is fine
        self.leave = Leave.ALL  # what may be asked
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
        """A request went out, or could not because there is no bus now."""
        if self._low:
            self.leave = Leave.NOTHING
        elif not sent:
            self._unanswered_since_s = None
        elif self._unanswered_since_s is None:
            self._unanswered_since_s = now_s
        elif now_s - self._unanswered_since_s >= self._patience_s:
            self._stop(
                f"no answer for {self._patience_s:.0f} s: the car sleeps, or is another one"
            )

    def answered(self) -> None:
        """Note an answer of a control unit, be it a refusal."""
        self._unanswered_since_s = None
        if not self._low:
            self._patience_s, self._wait_s = UNANSWERED_S, 0.0

    def record_frame(self, can_id: int, extended: bool, now_s: float) -> bool:
        """Record a frame of any id; True when asking is worth a try again."""
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
        """The car drives, stands, or draws current."""
        if isinstance(reading, SpeedReading) and abs(reading.speed) > STANDSTILL:
            self._moved_s = now_s
        elif isinstance(reading, BatteryReading):
            self._observe_current(reading.current, now_s)

    def auxiliary(self, voltage: float, now_s: float) -> None:
        """The voltage of the 12 V battery."""
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
            self._stop(f"no current for {IDLE_FOR_S / 60:.0f} min: asking would keep it awake")

    def _stop(self, reason: str) -> None:
        self.reason, self.leave = self.reason or reason, Leave.NOTHING
        self._traffic.awake = self._low  # no answer to whatever went on: that is no awakening

    def _resume(self, patience_s: float) -> None:
        self.reason, self.leave, self._patience_s = None, Leave.ALL, patience_s
        self._unanswered_since_s = self._low_since_s = self._idle_since_s = None


class _Traffic:
    """Distinguishes the traffic of a car that woke from a stray frame."""

    def __init__(self) -> None:
        self.awake = False  # after a silence, several ids came close together
        self._newest_s = -math.inf
        self._waking = False
        self._first_s = -math.inf
        self._frames = 0
        self._ids: set[int] = set()

    def record(self, can_id: int, extended: bool, now_s: float) -> None:
        """Record a frame. Those of testers hold no information on the car."""
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
