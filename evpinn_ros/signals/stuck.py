"""A sensor that repeats one value while the other says that the car does something else."""

from __future__ import annotations

from collections.abc import Hashable
import math

from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading

SPEED_STUCK, BATTERY_STUCK = "speed_stuck", "battery_stuck"
LONG = 2.0  # s of one value
OFTEN = 10  # readings of it
WINDOW_NS = 15 * NANOSECONDS  # beyond, a hilly road under cruise control would look the same
POWER_SWING = 30e3  # W that a car at one speed does not go through in that time
# A speed in whole km/h or mph repeats by itself: for 3.9 s and 66 kW in 13 real drives so rounded.
FINE = 0.1  # m/s, a step of finer speeds
COARSE_LONG, COARSE_SWING = 5.0, 60e3
SPEED_SWING = 5.0  # m/s that no car goes through at one voltage and one current
MOVING = 2.0  # m/s


class StuckSuspicion:
    """Whether speed or battery repeat one value to the last bit, against what the other tells."""

    def __init__(self) -> None:
        """Nothing seen, nothing suspected."""
        self._speed, self._battery = _Repeats(), _Repeats()
        self._step = math.inf  # smallest change of speed seen, m/s

    def push(self, reading: Reading) -> None:
        """Learn from a reading of any kind."""
        if isinstance(reading, SpeedReading):
            before = self._speed.value
            if isinstance(before, float) and reading.speed != before:
                self._step = min(self._step, abs(reading.speed - before))
            self._speed.push(reading.stamp_ns, reading.speed, self._speed_limits[0])
            self._battery.witness(reading.stamp_ns, reading.speed)
        elif isinstance(reading, BatteryReading) and math.isfinite(reading.power):
            self._battery.push(reading.stamp_ns, (reading.voltage, reading.current), LONG)
            self._speed.witness(reading.stamp_ns, reading.power)

    @property
    def suspected(self) -> str | None:
        """`SPEED_STUCK`, `BATTERY_STUCK` or None."""
        if self._battery.swing > SPEED_SWING:
            return BATTERY_STUCK
        speed = self._speed.value
        moving = isinstance(speed, float) and abs(speed) > MOVING
        return SPEED_STUCK if moving and self._speed.swing > self._speed_limits[1] else None

    @property
    def _speed_limits(self) -> tuple[float, float]:
        """How long a speed repeats, s, through which swing of power, W, before it is suspected."""
        return (LONG, POWER_SWING) if self._step < FINE else (COARSE_LONG, COARSE_SWING)


class _Repeats:
    """How long a value repeats, and through what another one went meanwhile."""

    def __init__(self) -> None:
        self.value: Hashable = None
        self._begin(0)

    def _begin(self, stamp_ns: int) -> None:
        self._since_ns, self._count, self._found = stamp_ns, 0, 0.0
        self._begin_window(stamp_ns)

    def _begin_window(self, stamp_ns: int) -> None:
        self._window_ns, self._low, self._high = stamp_ns, math.inf, -math.inf

    @property
    def swing(self) -> float:
        """Of the other value while this one stood still; 0 until that is long enough."""
        return self._found

    def push(self, stamp_ns: int, value: Hashable, long: float) -> None:
        if value != self.value or stamp_ns < self._since_ns:
            self.value = value
            self._begin(stamp_ns)
        self._count += 1
        if self._count >= OFTEN and stamp_ns - self._since_ns >= long * NANOSECONDS:
            self._found = max(self._found, self._high - self._low)

    def witness(self, stamp_ns: int, value: float) -> None:
        if abs(stamp_ns - self._window_ns) > WINDOW_NS:
            self._begin_window(stamp_ns)
        self._low, self._high = min(self._low, value), max(self._high, value)
