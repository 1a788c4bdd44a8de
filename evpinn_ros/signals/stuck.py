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
# Before that is long enough, a speed that repeats is in doubt: nothing is learned until it moves.
# A cruise control keeps even a fine speed for a second, now and then for two; a car that speeds up
# or slows down keeps none.
DOUBTED_AFTER, COARSE_DOUBTED_AFTER, SOON_DOUBTED_AFTER = 1.0, 2.0, 0.35  # s
CHANGING, CHANGE_NS = 0.5, NANOSECONDS  # m/s within that time before: no cruise control
COARSE_DOUBT_SWING = 20e3  # W
SETTLES_NS = NANOSECONDS // 2  # before and after, which smoothing reaches and in which it leaps
SPOILT_KEPT = 20
SPEED_SWING = 5.0  # m/s that no car goes through at one voltage and one current
IDLE_POWER = 5e3  # W; a full battery takes no more while friction stops the car, or none at all
MOVING = 2.0  # m/s


class StuckSuspicion:
    """Detector of a speed or battery that repeats one value while the other changes."""

    def __init__(self) -> None:
        """Start without data."""
        self._speed, self._battery = _Repeats(), _Repeats()
        # Why, since when and until when a signal repeated: what lies behind is learned from later.
        self._spoilt: deque[tuple[str, int, int]] = deque(maxlen=SPOILT_KEPT)
        self._step = math.inf  # smallest change of speed seen, m/s
        self._changes: deque[tuple[int, float]] = deque()  # speeds of the last second
        self._changed = False  # before the speed began to repeat

    def add_reading(self, reading: Reading) -> None:
        """Learn from a reading of any kind."""
        if isinstance(reading, SpeedReading):
            before = self._speed.value
            if isinstance(before, float) and reading.speed != before:
                self._step = min(self._step, abs(reading.speed - before))
                self._change(reading)
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

    def _change(self, reading: SpeedReading) -> None:
        """Note whether the car speeds up or slows down at a speed that is another."""
        self._changes.append((reading.stamp_ns, reading.speed))
        while not reading.stamp_ns - CHANGE_NS <= self._changes[0][0] <= reading.stamp_ns:
            self._changes.popleft()
        self._changed = abs(reading.speed - self._changes[0][1]) > CHANGING

    def _note(self) -> None:
        """Keep since when a signal repeats that is suspected or in doubt."""
        reason = self.suspected or (SPEED_REPEATS if self._in_doubt() else None)
        if reason is None:
            return
        found = self._battery if reason == BATTERY_STUCK else self._speed
        if self._spoilt and self._spoilt[-1][:2] == (reason, found.since_ns):
            self._spoilt.pop()
        self._spoilt.append((reason, found.since_ns, found.newest_ns))

    def _in_doubt(self) -> bool:
        """True if the speed repeats in motion, if not long enough to be suspected."""
        speed, fine = self._speed.value, self._step < FINE
        if not (isinstance(speed, float) and abs(speed) > MOVING):
            return False
        long = COARSE_DOUBTED_AFTER
        if fine:
            long = SOON_DOUBTED_AFTER if self._changed else DOUBTED_AFTER
        seconds = (self._speed.newest_ns - self._speed.since_ns) / NANOSECONDS
        return seconds >= long and (fine or self._speed.range > COARSE_DOUBT_SWING)

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
        self._count, self._found, self._risen = 0, 0.0, 0.0
        self._begin_window(stamp_ns)

    def _begin_window(self, stamp_ns: int) -> None:
        self._window_ns, self._low, self._high = stamp_ns, math.inf, -math.inf
        self._climb = 0.0

    @property
    def swing(self) -> float:
        """Of the other value while this one stood still; 0 until that is long enough."""
        return self._found

    @property
    def rise(self) -> float:
        """The same, upwards alone."""
        return self._risen

    @property
    def range(self) -> float:
        """Of the other value in the present window."""
        return self._high - self._low

    def add(self, stamp_ns: int, value: Hashable, long: float) -> None:
        if value != self.value or stamp_ns < self.since_ns:
            self.value = value
            self._begin(stamp_ns)
        self._count += 1
        self.newest_ns = stamp_ns
        if self._count >= OFTEN and stamp_ns - self.since_ns >= long * NANOSECONDS:
            self._found = max(self._found, self._high - self._low)
            self._risen = max(self._risen, self._climb)

    def witness(self, stamp_ns: int, value: float) -> None:
        if abs(stamp_ns - self._window_ns) > WINDOW_NS:
            self._begin_window(stamp_ns)
        self._low, self._high = min(self._low, value), max(self._high, value)
        self._climb = max(self._climb, value - self._low)
