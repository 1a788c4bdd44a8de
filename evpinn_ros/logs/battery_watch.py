"""What the values of a bag or a CAN log say against its battery, as `values` does for tables.

Units and signs of both are stated, so none is guessed. But robots send a current of 0 all the
time, and some drivers the sign of a charger.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
import math

import numpy as np

from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    Reading,
    SpeedReading,
    drawn_power,
    why_impossible,
)
from evpinn_ros.logs.signal import EVENT, LEAST_EVENTS, Signal, accelerations, at_times, pull
from evpinn_ros.logs.values import never_back

WRONG_SIGN = (
    "the car speeds up while its battery is charged: the sign of the current is probably wrong, "
    "and with it every energy; it is negative while the battery discharges"
)


class BatteryWatch:
    """Passes on the readings of a drive, and notes what its battery cannot be.

    Attributes:
        notes: sentences, complete once all is read.
    """

    def __init__(self) -> None:
        self.notes: tuple[str, ...] = ()
        self._speed: list[tuple[int, float]] = []
        self._voltage: list[tuple[int, float]] = []
        self._current: list[tuple[int, float]] = []

    def on(self, readings: Iterable[Reading]) -> Iterator[Reading]:
        """The readings, without a current that never changes.

        Those from the first current on wait until there is another one; a log of a car that
        drives does not wait for long.
        """
        waiting: list[Reading] = []
        first, changes = math.nan, False
        for reading in readings:
            self._take(reading)
            if isinstance(reading, BatteryReading) and math.isfinite(reading.current):
                first = reading.current if math.isnan(first) else first
                if reading.current != first and not changes:
                    changes = True
                    yield from waiting
                    waiting = []
            if math.isnan(first) or changes:
                yield reading
            else:
                waiting.append(reading)
        speed = _signal(self._speed)
        if waiting and not changes and self._drives(speed):
            never = f"battery current: always {first + 0.0:g} A while the car speeds up and slows"
            self.notes = (f"{never} down, so it is not measured",)
            waiting = list(map(_without_current, waiting))
        elif changes:
            self.notes = tuple(self._doubts(speed))
        yield from waiting

    def _take(self, reading: Reading) -> None:
        if why_impossible(reading) is not None:
            return
        if isinstance(reading, SpeedReading):
            self._speed.append((reading.stamp_ns, reading.speed))
        elif isinstance(reading, BatteryReading):
            self._voltage.append((reading.stamp_ns, reading.voltage))
            self._current.append((reading.stamp_ns, reading.current))

    def _drives(self, speed: Signal) -> bool:
        changes = np.abs(accelerations(speed)[1]) > EVENT
        return len(self._current) >= LEAST_EVENTS <= int(changes.sum())

    def _doubts(self, speed: Signal) -> Iterator[str]:
        current = _signal(self._current)
        voltage = at_times(_signal(self._voltage), current.time)
        drawn = Signal(current.time, drawn_power(voltage, current.value))
        if pull(speed, drawn) < 0.0:
            yield WRONG_SIGN
        elif self._drives(speed):
            yield from never_back(drawn)


def _signal(rows: list[tuple[int, float]]) -> Signal:
    """Rows of stamp, ns, and value."""
    zero_ns = rows[0][0] if rows else 0
    time = np.array([stamp_ns - zero_ns for stamp_ns, _ in rows], float) / NANOSECONDS
    return Signal(time, np.array([value for _, value in rows], float))


def _without_current(reading: Reading) -> Reading:
    return replace(reading, current=math.nan) if isinstance(reading, BatteryReading) else reading
