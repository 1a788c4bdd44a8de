"""When to stop asking: a car that is asked stays awake, and its 12 V battery pays for it.

A stop lasts until the bus, after a silence, speaks again: the car woke by itself. Where nothing
is broadcast, as behind the gateway at many diagnostic plugs, it lasts until the node is started
anew. There is no probing in between, for a probe can wake a car.
"""

from __future__ import annotations

from evpinn_ros.signals.readings import BatteryReading, Reading, SpeedReading

UNANSWERED_S = 30.0
"""Silence of every control unit after which the car is taken to be asleep."""

QUIET_S = 10.0
"""Silence of the whole bus after which the next frame means that the car woke."""

LOW_VOLTAGE = 12.0  # V: about 40 % charge of a lead battery at rest
LOW_FOR_S = 10.0
DRIVING_FOR_S = 5.0
"""The 12 V battery may be low while driving: the car charges it."""
STANDSTILL = 0.5  # m/s

IDLE_CURRENT = 0.3  # A: a car that is ready to drive, or charges, draws more
IDLE_FOR_S = 600.0


class Restraint:
    """Watches what comes back; all times in s of a clock that never goes back.

    Attributes:
        reason: why not to ask, None while asking is fine.
    """

    def __init__(self) -> None:
        self.reason: str | None = None
        self._unanswered_since_s: float | None = None
        self._low_since_s: float | None = None
        self._idle_since_s: float | None = None
        self._moved_s: float | None = None
        self._heard_s: float | None = None

    def asked(self, now_s: float, sent: bool) -> None:
        """A request went out, or could not because there is no bus now."""
        if not sent:
            self._unanswered_since_s = None
        elif self._unanswered_since_s is None:
            self._unanswered_since_s = now_s
        elif now_s - self._unanswered_since_s >= UNANSWERED_S:
            self._stop(f"no answer for {UNANSWERED_S:.0f} s: the car sleeps, or is another one")

    def answered(self) -> None:
        """A control unit said anything, be it a refusal."""
        self._unanswered_since_s = None

    def heard(self, now_s: float) -> bool:
        """A frame of whatever id came; True when it ends a stop."""
        silent = self._heard_s is None or now_s - self._heard_s >= QUIET_S
        self._heard_s = now_s
        if self.reason is None or not silent:
            return False
        self.reason = None
        self._unanswered_since_s = self._low_since_s = self._idle_since_s = None
        return True

    def observe(self, reading: Reading, now_s: float) -> None:
        """The car drives, stands, or draws current."""
        if isinstance(reading, SpeedReading) and abs(reading.speed) > STANDSTILL:
            self._moved_s = now_s
        elif isinstance(reading, BatteryReading):
            self._observe_current(reading.current, now_s)

    def auxiliary(self, voltage: float, now_s: float) -> None:
        """The voltage of the 12 V battery."""
        driving = self._moved_s is not None and now_s - self._moved_s < DRIVING_FOR_S
        if voltage >= LOW_VOLTAGE or driving:
            self._low_since_s = None
        elif self._low_since_s is None:
            self._low_since_s = now_s
        elif now_s - self._low_since_s >= LOW_FOR_S:
            self._stop(f"the 12 V battery is low: {voltage:.1f} V")

    def _observe_current(self, current: float, now_s: float) -> None:
        if abs(current) > IDLE_CURRENT:
            self._idle_since_s = None
        elif self._idle_since_s is None:
            self._idle_since_s = now_s
        elif now_s - self._idle_since_s >= IDLE_FOR_S:
            self._stop(f"no current for {IDLE_FOR_S / 60:.0f} min: asking would keep it awake")

    def _stop(self, reason: str) -> None:
        self.reason = self.reason or reason
