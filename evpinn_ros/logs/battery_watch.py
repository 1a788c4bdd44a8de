"""What the values of a bag or a CAN log say against its battery, as `values` does for tables.

Units and signs of both are stated, so none is guessed. But some robots always send 0 A, and some
device drivers send the current with the sign of a charger.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
import math

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    Reading,
    SpeedReading,
    drawn_power,
    why_impossible,
)
from evpinn_ros.logs.quantities import PLACES
from evpinn_ros.logs.signal import Signal, at_times, pull, speeds_up_and_down
from evpinn_ros.logs.source import STRAGGLING_NS
from evpinn_ros.logs.standing import Standing
from evpinn_ros.logs.values import drawn_at_rest, never_back, wrong_sign

STATED = "it is negative while the battery discharges, and every energy has the other sign"
BLOCK = 20_000  # readings that are judged together
QUANTITIES = ("speed", "voltage", "current", *PLACES)
NONE = (math.nan,) * len(QUANTITIES)
MOST_KEPT = 30_000  # readings of each signal, by which the sign is judged: 50 min at 10 Hz


class BatteryWatch:
    """Passes on the readings of a drive that are measured, and notes what its battery cannot be.

    Attributes:
        notes: sentences, complete once all is read.
    """

    def __init__(self, dropped: Counter[str]) -> None:
        """Begin; what stands still is counted in `dropped`."""
        self.notes: tuple[str, ...] = ()
        self._standing = Standing(dropped)
        self._speed: list[tuple[int, float]] = []
        self._voltage: list[tuple[int, float]] = []
        self._current: list[tuple[int, float]] = []
        self._flows_back, self._zero_ns = False, 0

    def on(self, readings: Iterable[Reading]) -> Iterator[Reading]:
        """The readings, block by block, without those that stand still while the car does not.

        What came before an error of the source is passed on before it.
        """
        block: list[Reading] = []
        newest, error = 0, None
        try:
            for reading in readings:
                if isinstance(reading, SpeedReading):
                    back, newest = reading.stamp_ns < newest - STRAGGLING_NS, reading.stamp_ns
                    if back or len(block) >= BLOCK:
                        yield from self._measured(block)
                        block = []
                block.append(reading)
        except InputError as broken:
            error = broken
        yield from self._measured(block)
        self.notes = (*self._standing.notes, *self._doubts())
        if error is not None:
            raise error

    def _measured(self, block: list[Reading]) -> Iterator[Reading]:
        stamps = np.array([reading.stamp_ns for reading in block], np.int64)
        table = np.array([_row(reading) for reading in block], float).reshape(-1, len(QUANTITIES))
        values = {name: table[:, i] for i, name in enumerate(QUANTITIES)}
        self._standing.drop(stamps, values, np.argsort(stamps, kind="stable"))
        for reading, speed, current in zip(
            block, values["speed"].tolist(), values["current"].tolist(), strict=True
        ):
            if isinstance(reading, SpeedReading) and math.isnan(speed - reading.speed):
                continue
            if isinstance(reading, BatteryReading) and math.isnan(current):
                reading = replace(reading, current=current)
            self._take(reading)
            yield reading

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

    def _doubts(self) -> Iterator[str]:
        speed = _signal(self._speed, self._zero_ns)
        current = _signal(self._current, self._zero_ns)
        voltage = at_times(_signal(self._voltage, self._zero_ns), current.time)
        drawn = Signal(current.time, drawn_power(voltage, current.value))
        yield from drawn_at_rest(drawn, speed)
        if pull(speed, drawn) < 0.0:
            yield wrong_sign("the current", STATED)
        elif speeds_up_and_down(speed) and not self._flows_back:
            yield from never_back(drawn, speed)


def _keep(rows: list[tuple[int, float]], stamp_ns: int, value: float) -> None:
    """Append to a signal, unless enough is known of it."""
    if len(rows) < MOST_KEPT:
        rows.append((stamp_ns, value))


def _signal(rows: list[tuple[int, float]], zero_ns: int) -> Signal:
    """Rows of stamp, ns, and value, with time in s since a stamp."""
    time = np.array([stamp_ns - zero_ns for stamp_ns, _ in rows], float) / NANOSECONDS
    return Signal(time, np.array([value for _, value in rows], float))


def _row(reading: Reading) -> tuple[float, ...]:
    """The values of a reading, by `QUANTITIES`."""
    if isinstance(reading, SpeedReading):
        return reading.speed, *NONE[1:]
    if isinstance(reading, BatteryReading):
        return NONE[0], reading.voltage, -reading.current, *NONE[3:]
    if isinstance(reading, AltitudeReading):
        return *NONE[:3], reading.latitude, reading.longitude
    return NONE
