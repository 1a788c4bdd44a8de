"""What the values of a bag or a CAN log say against its battery, as `values` does for tables.

Units and signs of both are stated, so none is guessed. But some robots always send 0 A, and some
device drivers send the current with the sign of a charger.
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
from evpinn_ros.logs.signal import LEAST_EVENTS, Signal, at_times, pull, speeds_up_and_down
from evpinn_ros.logs.values import always, never_back, wrong_sign

STATED = "it is negative while the battery discharges, and every energy has the other sign"
MOST_KEPT = 30_000  # readings of each signal, by which the sign is judged: 50 min at 10 Hz


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
        self._flows_back, self._zero_ns = False, 0

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
        speed = _signal(self._speed, self._zero_ns)
        if waiting and not changes and self._drives(speed):
            self.notes = (f"battery current: {always(first)}, so it is not measured",)
            waiting = list(map(_without_current, waiting))
        elif changes:
            self.notes = tuple(self._doubts(speed))
        yield from waiting

    def _take(self, reading: Reading) -> None:
        if why_impossible(reading) is not None:
            return
        self._zero_ns = self._zero_ns or reading.stamp_ns
        if isinstance(reading, SpeedReading):
            _keep(self._speed, reading.stamp_ns, reading.speed)
        elif isinstance(reading, BatteryReading):
            self._flows_back |= reading.current > 0.0
            _keep(self._voltage, reading.stamp_ns, reading.voltage)
            _keep(self._current, reading.stamp_ns, reading.current)

    def _drives(self, speed: Signal) -> bool:
        return len(self._current) >= LEAST_EVENTS and speeds_up_and_down(speed)

    def _doubts(self, speed: Signal) -> Iterator[str]:
        current = _signal(self._current, self._zero_ns)
        voltage = at_times(_signal(self._voltage, self._zero_ns), current.time)
        drawn = Signal(current.time, drawn_power(voltage, current.value))
        if pull(speed, drawn) < 0.0:
            yield wrong_sign("the current", STATED)
        elif self._drives(speed) and not self._flows_back:
            yield from never_back(drawn, speed)


def _keep(rows: list[tuple[int, float]], stamp_ns: int, value: float) -> None:
    """Append to a signal, unless enough is known of it."""
    if len(rows) < MOST_KEPT:
        rows.append((stamp_ns, value))


def _signal(rows: list[tuple[int, float]], zero_ns: int) -> Signal:
    """Rows of stamp, ns, and value, with time in s since a stamp."""
    time = np.array([stamp_ns - zero_ns for stamp_ns, _ in rows], float) / NANOSECONDS
    return Signal(time, np.array([value for _, value in rows], float))


def _without_current(reading: Reading) -> Reading:
    return replace(reading, current=math.nan) if isinstance(reading, BatteryReading) else reading
