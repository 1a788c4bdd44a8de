"""Checks a bag's or CAN log's battery: some robots send 0 A, some drivers a charger's sign."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.block import FIELDS, Block, Rows, impossible, joined
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    Reading,
    SpeedReading,
    drawn_power,
)
from evpinn_ros.logs.quantities import PLACES
from evpinn_ros.logs.signal import Signal, at_times, pull, speeds_up_and_down
from evpinn_ros.logs.source import STRAGGLING_NS
from evpinn_ros.logs.standing import Standing
from evpinn_ros.logs.values import drawn_at_rest, never_back, wrong_sign

STATED = "it is negative while the battery discharges, and every energy has the other sign"
BLOCK = 20_000  # readings that are judged together
QUANTITIES = ("speed", "voltage", "current", *PLACES)
MOST_KEPT = 60_000  # readings by which the sign is judged: 50 min of speed and battery at 10 Hz


class BatteryWatch:
    """Passes on the measured readings of a drive, and notes what its battery cannot be."""

    def __init__(self, dropped: Counter[str]) -> None:
        self.notes: tuple[str, ...] = ()  # sentences, complete once all is read
        self._standing = Standing(dropped)
        self._kept: list[Block] = []
        self._flows_back = False

    def on(self, readings: Iterable[Reading]) -> Iterator[Block]:
        """Blocks without readings that stand still while the car moves; then any error."""
        block: list[Reading] = []
        newest, error = 0, None
        try:
            for reading in readings:
                if isinstance(reading, SpeedReading):
                    back, newest = reading.stamp_ns < newest - STRAGGLING_NS, reading.stamp_ns
                    if back or len(block) >= BLOCK:
                        yield self._measured(Block.of(block))
                        block = []
                block.append(reading)
        except InputError as broken:
            error = broken
        if block:
            yield self._measured(Block.of(block))
        self.notes = (*self._standing.notes, *self._doubts())
        if error is not None:
            raise error

    def _measured(self, block: Block) -> Block:
        stamps = block.stamps()
        values = {name: np.full(block.length, np.nan) for name in QUANTITIES}
        for kind, names in FIELDS.items():
            order, _, fields = block.of_kind(kind)
            for name, column in zip(names, fields, strict=False):
                if name in values:
                    values[name][order] = -column if name == "current" else column
        self._standing.drop(stamps, values, np.argsort(stamps, kind="stable"))
        speeds, battery = block.of_kind(SpeedReading), block.of_kind(BatteryReading)
        if len(battery.order):
            fields = battery.values.copy()
            fields[1, np.isnan(values["current"][battery.order])] = np.nan
            block = block.with_rows(BatteryReading, battery._replace(values=fields))
        moves = ~np.isnan(values["speed"][speeds.order]) | np.isnan(speeds.values[0])
        block = block.only({SpeedReading: moves})
        if sum(map(len, self._kept)) < MOST_KEPT:
            self._kept.append(block)
        self._flows_back |= bool((_possible(block, BatteryReading).values[1] > 0.0).any())
        return block

    def _doubts(self) -> Iterator[str]:
        kept = joined(self._kept)
        speeds, battery = (_possible(kept, kind) for kind in (SpeedReading, BatteryReading))
        zero_ns = kept.stamps()[:1]
        speed = Signal((speeds.stamps - zero_ns) / NANOSECONDS, speeds.values[0])
        time = (battery.stamps - zero_ns) / NANOSECONDS
        voltage = at_times(Signal(time, battery.values[0]), time)
        drawn = Signal(time, drawn_power(voltage, battery.values[1]))
        yield from drawn_at_rest(drawn, speed)
        if pull(speed, drawn) < 0.0:
            yield wrong_sign("the current", STATED)
        elif speeds_up_and_down(speed) and not self._flows_back:
            yield from never_back(drawn, speed)


def _possible(block: Block, kind: type[Reading]) -> Rows:
    rows = block.of_kind(kind)
    possible = np.ones(len(rows.order), dtype=bool)
    for _, wrong in impossible(kind, rows):
        possible[wrong] = False
    return rows.where(possible)
