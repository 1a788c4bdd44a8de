"""Checks the battery of a bag or CAN log: some robots send 0 A, some drivers the wrong sign."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.block import FIELDS, Block, Rows, impossible, joined
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    Reading,
    SpeedReading,
)
from evpinn_ros.logs.contradictions import energy_doubts, never_back, wrong_sign
from evpinn_ros.logs.frozen_values import FrozenValues
from evpinn_ros.logs.quantities import PLACES
from evpinn_ros.logs.signal import Signal, battery_power, pull, speeds_up_and_down
from evpinn_ros.logs.source import STRAGGLING_NS

STATED = "it must be negative while the battery discharges; now every energy has the wrong sign"
BLOCK = 20_000  # readings that are checked together
QUANTITIES = ("speed", "voltage", "current", *PLACES)
MOST_KEPT = 60_000  # readings to check the sign with: 50 min of speed and battery at 10 Hz


class BatteryWatch:
    """Passes on the measured readings of a drive, and notes implausible battery values."""

    def __init__(self, dropped: Counter[str]) -> None:
        # notes, complete once all is read; doubts are those that make totals uncertain
        self.notes: tuple[str, ...] = ()
        self.doubts: tuple[str, ...] = ()
        self._frozen = FrozenValues(dropped)
        self._kept: list[Block] = []
        self._flows_back = False

    def on(self, readings: Iterable[Reading]) -> Iterator[Block]:
        """Blocks without values frozen while the car moves; an InputError of the input is last."""
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
        signals = self._signals()
        self.doubts = tuple(_doubts(signals))
        self.notes = (*self._frozen.notes, *self.doubts, *self._never_back(signals))
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
        self._frozen.drop(stamps, values, np.argsort(stamps, kind="stable"))
        speeds, battery = block.of_kind(SpeedReading), block.of_kind(BatteryReading)
        moves = ~np.isnan(values["speed"][speeds.order]) | np.isnan(speeds.values[0])
        chosen: dict[type[Reading], np.ndarray] = {SpeedReading: moves}
        if len(battery.order):
            fields = battery.values.copy()
            fields[1, np.isnan(values["current"][battery.order])] = np.nan
            chosen[BatteryReading] = ~(
                np.isnan(values["voltage"][battery.order]) & np.isfinite(fields[0])
            )
            block = block.with_rows(BatteryReading, battery._replace(values=fields))
        block = block.only(chosen)
        if sum(map(len, self._kept)) < MOST_KEPT:
            self._kept.append(block)
        self._flows_back |= bool((_possible(block, BatteryReading).values[1] > 0.0).any())
        return block

    def _signals(self) -> dict[str, Signal]:
        """Speed, m/s, voltage, V, and drawn current, A, of the readings kept."""
        kept = joined(self._kept)
        speeds, battery = (_possible(kept, kind) for kind in (SpeedReading, BatteryReading))
        zero_ns = kept.stamps()[:1]
        time = (battery.stamps - zero_ns) / NANOSECONDS
        return {
            "speed": Signal((speeds.stamps - zero_ns) / NANOSECONDS, speeds.values[0]),
            "voltage": Signal(time, battery.values[0]),
            "current": Signal(time, -battery.values[1]),
        }

    def _never_back(self, signals: Mapping[str, Signal]) -> Iterator[str]:
        drawn, speed = battery_power(signals), signals["speed"]
        if drawn is not None and speeds_up_and_down(speed) and not self._flows_back:
            yield from never_back(drawn, speed)


def _doubts(signals: Mapping[str, Signal]) -> Iterator[str]:
    drawn = battery_power(signals)
    if drawn is not None and pull(signals["speed"], drawn) < 0.0:
        yield wrong_sign("the current", STATED)
    yield from energy_doubts(signals, "the current")


def _possible(block: Block, kind: type[Reading]) -> Rows:
    rows = block.of_kind(kind)
    possible = np.ones(len(rows.order), dtype=bool)
    for _, wrong in impossible(kind, rows):
        possible[wrong] = False
    return rows.where(possible)
