"""Checks the current of a bus against the sign that its profile declares."""

from __future__ import annotations

import math

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.core.signals.reorder import ReorderBuffer
from evpinn_ros.core.signals.road import GradeSource
from evpinn_ros.core.signals.sign_detectors import ChargeDetector, SignDetector
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings
from evpinn_ros.core.signals.time_jump import Jump, StampGuard

PERIOD_NS = NANOSECONDS // 11
"""Readings sooner after the last are skipped: accelerations need ten a second."""
AT_ONCE = 500  # readings that are checked together
LONGEST_STEP = 2.0  # s: longest time that one reading counts for
AIR_DENSITY = 1.2  # kg/m^3; the stream needs it, the sign does not


class CurrentSign:
    """Follows the readings of one bus; reports a wrong sign but corrects nothing."""

    def __init__(self) -> None:
        settings = StreamSettings(grade_source=GradeSource.NONE)
        self._stream, self._time = SampleStream(settings, AIR_DENSITY), StampGuard(SpeedReading)
        self._buffer = ReorderBuffer(settings.allowed_lateness)
        self._driving, self._charging = SignDetector(), ChargeDetector()
        self._newest: dict[type[Reading], int] = {}
        self._waiting: list[Reading] = []
        self._sampled_ns = 0
        self._speed, self._speed_ns = math.nan, 0

    @property
    def decided(self) -> bool:
        """True if the car pulled away, braked or charged enough to judge the sign."""
        self._follow()
        return self._driving.verdict is not None or self._charging.verdict is not None

    @property
    def fault(self) -> str | None:
        """Detected fault and its remedy, in one line; None without a fault."""
        self._follow()
        if fault := self._driving.detected:
            why = "accelerating charges the battery"
        elif fault := self._charging.detected:
            why = "charging empties the battery"
        else:
            return None
        return f"{fault}: {why}; flip positive_means in the profile"

    def add_reading(self, reading: Reading) -> None:
        """Learn from a reading; readings are not joined across a time jump."""
        for item in self._time.admit(type(reading), reading.stamp_ns, reading):
            if isinstance(item, Jump):
                self._follow()
                self._buffer.reset()
                self._stream.reset()
                self._newest.clear()
            else:
                self._add_reading(item)

    def _add_reading(self, reading: Reading) -> None:
        newest = self._newest.get(type(reading))
        if newest is not None and 0 <= reading.stamp_ns - newest < PERIOD_NS:
            return
        self._newest[type(reading)] = reading.stamp_ns
        if isinstance(reading, SpeedReading):
            self._speed, self._speed_ns = reading.speed, reading.stamp_ns
        elif isinstance(reading, BatteryReading):
            self._add_battery(reading, newest)
        self._waiting.append(reading)
        if len(self._waiting) == AT_ONCE:
            self._follow()

    def _follow(self) -> None:
        waiting, self._waiting = self._waiting, []
        in_order, _ = self._buffer.add(Block.of(waiting))
        measured = self._stream.add(in_order).measured
        for sample, power in zip(measured.samples.rows(), measured.power.tolist(), strict=True):
            step = _step(sample.stamp_ns, self._sampled_ns)
            self._sampled_ns = sample.stamp_ns
            moved = sample.speed, sample.acceleration
            self._driving = self._driving.after(*moved, power, step)

    def _add_battery(self, reading: BatteryReading, before_ns: int | None) -> None:
        if before_ns is None or math.isnan(reading.power):
            return
        age_ns = abs(reading.stamp_ns - self._speed_ns)
        speed = self._speed if age_ns < LONGEST_STEP * NANOSECONDS else math.nan
        step = _step(reading.stamp_ns, before_ns)
        charge = reading.state_of_charge
        self._charging = self._charging.after(reading.power, charge, speed, step)


def _step(stamp_ns: int, before_ns: int) -> float:
    return min(max(stamp_ns - before_ns, 0) / NANOSECONDS, LONGEST_STEP)
