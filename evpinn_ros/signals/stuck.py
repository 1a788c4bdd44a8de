"""A sensor that repeats one value while the other shows that the car does something else."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
import math
from typing import Any

from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading

SPEED_STUCK, BATTERY_STUCK, SPEED_REPEATS = "speed_stuck", "battery_stuck", "speed_repeats"
LONG = 2.0  # s of one value
OFTEN = 10  # readings of it
WINDOW_NS = 15 * NANOSECONDS  # beyond, a hilly road under cruise control would look the same
POWER_SWING = 30e3  # W that a car at one speed does not go through in that time
# A speed in whole km/h or mph repeats by itself: for 3.9 s and 66 kW in 13 real drives so rounded.
FINE = 0.1  # m/s, a step of finer speeds
COARSE_LONG, COARSE_SWING = 5.0, 60e3
# Before that is long enough, a speed that repeats is in doubt while power changes, and it did hang
# if it leaps at last. One that goes on as it was did not: a cruise control keeps a fine speed for
# seconds, a simulator's driver for minutes, and between speeding up and slowing down any car does.
DOUBTED_AFTER, COARSE_DOUBTED_AFTER = 1.0, 2.0  # s
DOUBT_SWING = 20e3  # W that a car at one speed hardly goes through
LEAST_HANG = 0.35  # s; less is a gap between readings
LEAP, LEAP_STEPS, MOST_ACCELERATION = 0.5, 2.5, 3.0  # m/s, steps of the signal, m/s^2
SETTLES_NS = NANOSECONDS // 2  # before and after, which smoothing reaches and in which it leaps
SPOILT_KEPT = 20
SPEED_SWING = 5.0  # m/s that no car goes through at one voltage and one current
IDLE_POWER = 5e3  # W; a full battery takes no more while friction stops the car, or none at all
MOVING = 2.0  # m/s


class StuckDetector:
    """Detector of a speed or battery that repeats one value while the other changes."""

    def __init__(self) -> None:
        """Start without data."""
        self._speed, self._battery = _Repeats(), _Repeats()
        # Why, since when and until when a signal repeated: what lies behind is learned from later.
        self._spoilt: deque[tuple[str, int, int]] = deque(maxlen=SPOILT_KEPT)
        self._step = math.inf  # smallest change of speed seen, m/s

    def add_reading(self, reading: Reading) -> None:
        """Learn from a reading of any kind."""
        if isinstance(reading, SpeedReading):
            if isinstance(before := self._speed.value, float) and reading.speed != before:
                self._step = min(self._step, abs(reading.speed - before))
                if self._leaps(reading):
                    self._spoil(SPEED_REPEATS, self._speed)
            self._speed.add(reading.stamp_ns, reading.speed, self._speed_limits[0])
            self._battery.witness(reading.stamp_ns, reading.speed)
        elif isinstance(reading, BatteryReading) and math.isfinite(reading.power):
            self._battery.add(reading.stamp_ns, (reading.voltage, reading.current), LONG)
            self._speed.witness(reading.stamp_ns, reading.power)
        self._note()

    @property
    def suspected(self) -> str | None:
        """`SPEED_STUCK`, `BATTERY_STUCK` or None."""
        voltage, current = self._battery.value or (0.0, 0.0)
        idle = abs(voltage * current) < IDLE_POWER
        if (self._battery.rise if idle else self._battery.swing) > SPEED_SWING:
            return BATTERY_STUCK
        speed = self._speed.value
        moving = isinstance(speed, float) and abs(speed) > MOVING
        return SPEED_STUCK if moving and self._speed.swing > self._speed_limits[1] else None

    def why_not(self, begin_ns: int, end_ns: int) -> str | None:
        """Reason not to learn of a time that lies behind, or None."""
        for reason, first_ns, last_ns in self._spoilt:
            if begin_ns <= last_ns + SETTLES_NS and end_ns >= first_ns - SETTLES_NS:
                return reason
        return None

    def _leaps(self, reading: SpeedReading) -> bool:
        """True if a speed that repeated moves on farther than a car can: it did hang."""
        hung = (self._speed.newest_ns - self._speed.since_ns) / NANOSECONDS
        gap = (reading.stamp_ns - self._speed.newest_ns) / NANOSECONDS
        limit = max(LEAP, LEAP_STEPS * self._step) + MOST_ACCELERATION * gap
        return hung >= LEAST_HANG and abs(reading.speed - self._speed.value) > limit

    def _note(self) -> None:
        """Keep since when a signal repeats that is suspected or in doubt."""
        reason = self.suspected or (SPEED_REPEATS if self._in_doubt() else None)
        if reason is None:
            return
        self._spoil(reason, self._battery if reason == BATTERY_STUCK else self._speed)

    def _spoil(self, reason: str, found: _Repeats) -> None:
        """Learn nothing of the time in which a value repeated so far."""
        if self._spoilt and self._spoilt[-1][:2] == (reason, found.since_ns):
            self._spoilt.pop()
        self._spoilt.append((reason, found.since_ns, found.newest_ns))

    def _in_doubt(self) -> bool:
        """True if the speed repeats in motion while power changes, if not enough to suspect it."""
        speed = self._speed.value
        if not (isinstance(speed, float) and abs(speed) > MOVING):
            return False
        seconds = (self._speed.newest_ns - self._speed.since_ns) / NANOSECONDS
        long = DOUBTED_AFTER if self._step < FINE else COARSE_DOUBTED_AFTER
        return seconds >= long and self._speed.range > DOUBT_SWING

    @property
    def _speed_limits(self) -> tuple[float, float]:
        """Duration, s, and swing of power, W, from which a repeating speed is suspected."""
        return (LONG, POWER_SWING) if self._step < FINE else (COARSE_LONG, COARSE_SWING)


class _Repeats:
    """Repetition of one value, and the range of another one meanwhile."""

    def __init__(self) -> None:
        self.value: Any = None
        self._begin(0)

    def _begin(self, stamp_ns: int) -> None:
        self.since_ns = self.newest_ns = stamp_ns
        self._count, self._found, self._risen, self._range = 0, 0.0, 0.0, 0.0
        self._begin_window(stamp_ns)

    def _begin_window(self, stamp_ns: int) -> None:
        self._window_ns, self._low, self._high = stamp_ns, math.inf, -math.inf
        self._climb = 0.0

    @property
    def swing(self) -> float:
        """Range of the other value while this one stood still; 0 until that is long enough."""
        return self._found

    @property
    def rise(self) -> float:
        """Range of the other value, upwards alone."""
        return self._risen

    @property
    def range(self) -> float:
        """Range of the other value in this window, up to the last repetition of this one."""
        return self._range

    def add(self, stamp_ns: int, value: Hashable, long: float) -> None:
        if value != self.value or stamp_ns < self.since_ns:
            self.value = value
            self._begin(stamp_ns)
        self._count += 1
        self.newest_ns = stamp_ns
        self._range = self._high - self._low
        if self._count >= OFTEN and stamp_ns - self.since_ns >= long * NANOSECONDS:
            self._found = max(self._found, self._high - self._low)
            self._risen = max(self._risen, self._climb)

    def witness(self, stamp_ns: int, value: float) -> None:
        if abs(stamp_ns - self._window_ns) > WINDOW_NS:
            self._begin_window(stamp_ns)
        self._low, self._high = min(self._low, value), max(self._high, value)
        self._climb = max(self._climb, value - self._low)
