"""The reorder buffer: readings in any order in, columns in order of stamps out.

Only this module deals with arrival, lateness and duplicates. Readings wait until the watermark has
passed their stamps: the newest speed less the allowed lateness, or the newest battery reading
where speed is silent. The watermark moves in steps of `CELL_NS`, so a live node hands on a few
blocks a second whatever the load, and a file of minutes comes as one block. Later stages work in
event time: order of arrival within the allowed lateness changes nothing there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.block import NO_ROWS, Block, Rows, impossible
from evpinn_ros.core.signals.kinematics import LAG_TOLERANCE_NS
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    MotorReading,
    Reading,
    SpeedReading,
    why_impossible,
)
from evpinn_ros.core.signals.track import NEVER

CELL_NS = NANOSECONDS // 5  # step of the watermark
SILENT_NS = NANOSECONDS  # by which the battery may be ahead of speed
ALTITUDE_LATE_NS = 2 * NANOSECONDS  # by which GNSS may be late, and still counts
MOST_WAITING = 20_000  # readings of a kind, while neither speed nor battery moves the watermark
WHOLE_RECORDING = 1e9  # s
SERIES = {SpeedReading: "speed", BatteryReading: "battery", MotorReading: "motor_torque"}
"""Kinds that are interpolated: a late reading is dropped, those of others get a later stamp."""
LATE: Mapping[type[Reading], str] = {**SERIES, AltitudeReading: "altitude"}


class Arrived(NamedTuple):
    """Readings of one kind that were not dropped, in order of arrival.

    Attributes:
        order: their places among all readings of the block, shape (n,).
        stamps: ns, shape (n,).
        values: a row for each of `block.FIELDS`, shape (fields, n).
        watermark_ns: the watermark before each came, shape (n,).
    """

    order: np.ndarray
    stamps: np.ndarray
    values: np.ndarray
    watermark_ns: np.ndarray

    def where(self, chosen: np.ndarray) -> Arrived:
        """The readings of a mask."""
        return Arrived._make(column[..., chosen] for column in self)


class ReorderBuffer:
    """Sorts the readings of one car by stamps.

    Attributes:
        dropped: readings that are not handed on, by reason.
        watermark_ns: stamp up to which all readings were handed on.
    """

    def __init__(self, allowed_lateness: float, most_waiting: int = MOST_WAITING) -> None:
        """Wait `allowed_lateness`, s, for a reading that is late."""
        self._most_waiting = most_waiting
        self._allowed_ns = max(0, int(allowed_lateness * NANOSECONDS) - LAG_TOLERANCE_NS)
        self.shift_battery(0)
        self.dropped: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget what waits, after a jump of time."""
        self.watermark_ns = self._moved_ns = NEVER // CELL_NS * CELL_NS
        self._waiting: dict[type[Reading], Rows] = {}
        self._new: list[Reading] = []  # that came one by one, and wait too

    def shift_battery(self, shift_ns: int) -> None:
        """Expect battery stamps shifted by `shift_ns`: late if negative, early if positive."""
        self._late_ns = self._allowed_ns + max(0, -shift_ns)
        self._silent_ns = SILENT_NS + max(0, shift_ns)

    def add_reading(self, reading: Reading) -> tuple[bool, Block | None]:
        """Take one reading as it comes.

        Returns:
            Whether it is used, and the readings that the watermark passed; None if it stays.
        """
        kind, stamp_ns = type(reading), reading.stamp_ns
        if (reason := self._why_not(reading)) is not None:
            self.dropped[reason] += 1
            return False, None
        if kind not in SERIES and stamp_ns <= self.watermark_ns:
            reading = replace(reading, stamp_ns=self.watermark_ns + 1)
        self._new.append(reading)
        moved_ns = NEVER
        if kind is SpeedReading:
            moved_ns = stamp_ns - self._late_ns
        elif kind is BatteryReading:
            moved_ns = stamp_ns - self._late_ns - self._silent_ns
        if moved_ns > self._moved_ns:
            self._moved_ns = moved_ns
        watermark_ns = self._moved_ns // CELL_NS * CELL_NS
        if watermark_ns <= self.watermark_ns:
            if len(self._new) >= self._most_waiting:
                self._merge()
            return True, None
        self.watermark_ns = watermark_ns
        self._merge()
        return True, self._passed(watermark_ns)

    def _why_not(self, reading: Reading) -> str | None:
        """Reason not to use a reading, or None."""
        kind = type(reading)
        if (reason := why_impossible(reading)) is not None:
            return reason
        if isinstance(reading, BatteryReading) and (
            math.isnan(reading.voltage) and math.isnan(reading.current)
        ):
            return "battery_unmeasured"
        late_ns = self.watermark_ns - (ALTITUDE_LATE_NS if kind is AltitudeReading else 0)
        return f"{LATE[kind]}_late" if kind in LATE and reading.stamp_ns <= late_ns else None

    def _merge(self) -> None:
        """Merge the readings that came one by one into those that wait."""
        new, self._new = Block.of(self._new), []
        for kind, rows in new.rows.items():
            self._wait(kind, rows)

    def add(self, block: Block) -> tuple[Block, dict[type[Reading], Arrived]]:
        """Take readings as they come.

        Returns:
            The readings that the watermark passed, in order of stamps; and those that arrived.
        """
        self._merge()
        possible = {kind: self._possible(kind, rows) for kind, rows in block.rows.items()}
        places, marks = self._watermarks(possible)
        arrived = {}
        for kind, rows in possible.items():
            before = marks[places.searchsorted(rows.order)]
            late_ns = before - (ALTITUDE_LATE_NS if kind is AltitudeReading else 0)
            late = rows.stamps <= late_ns
            if kind in LATE and late.any():
                self.dropped[f"{LATE[kind]}_late"] += int(np.count_nonzero(late))
                rows, before = rows.where(~late), before[~late]
            arrived[kind] = Arrived(*rows, before)
            if kind not in SERIES:  # late readings of the surroundings count from now on
                rows = rows._replace(stamps=np.maximum(rows.stamps, before + 1))
            self._wait(kind, rows)
        self.watermark_ns = int(marks[-1])
        return self._passed(self.watermark_ns), arrived

    def flush(self) -> Block:
        """The readings that wait, in order of stamps, at the end of a drive."""
        self._merge()
        ends = [int(rows.stamps[-1]) for rows in self._waiting.values() if len(rows.stamps)]
        # A whole cell, so that later readings are late, and the watermark never falls.
        newest_ns = -(-max([self.watermark_ns, *ends]) // CELL_NS) * CELL_NS
        self.watermark_ns, self._moved_ns = newest_ns, max(self._moved_ns, newest_ns)
        return self._passed(self.watermark_ns)

    def _watermarks(self, rows: Mapping[type[Reading], Rows]) -> tuple[np.ndarray, np.ndarray]:
        """Places of n readings that may move the watermark, and watermarks, shape (n + 1,)."""
        speeds, battery = (
            rows.get(kind, NO_ROWS[kind]) for kind in (SpeedReading, BatteryReading)
        )
        order = np.concatenate((speeds.order, battery.order))
        moves = np.concatenate((speeds.stamps, battery.stamps - self._silent_ns)) - self._late_ns
        sequence = order.argsort()
        moved = np.maximum.accumulate(np.append(self._moved_ns, moves[sequence]))
        self._moved_ns = int(moved[-1])
        return order[sequence], moved // CELL_NS * CELL_NS

    def _possible(self, kind: type[Reading], rows: Rows) -> Rows:
        """The readings that are possible and not all NaN."""
        reasons = impossible(kind, rows)
        if kind is BatteryReading:
            reasons.append(("battery_unmeasured", np.isnan(rows.values[:2]).all(axis=0)))
        used = np.ones(len(rows.stamps), dtype=bool)
        for reason, wrong in reasons:
            if count := int(np.count_nonzero(wrong & used)):
                self.dropped[reason] += count
                used &= ~wrong
        return rows if used.all() else rows.where(used)

    def _wait(self, kind: type[Reading], rows: Rows) -> None:
        """Add readings to those that wait, in order of stamps.

        Of readings with one stamp the first counts; outside `SERIES` the last, because late ones
        have a later stamp.
        """
        if not len(rows.stamps):
            return
        waiting = self._waiting.get(kind)
        if waiting is not None and len(waiting.stamps):
            rows = Rows(
                *(np.concatenate(pair, axis=-1) for pair in zip(waiting, rows, strict=True))
            )
        if not (rows.stamps[1:] > rows.stamps[:-1]).all():
            rows = rows.where(rows.stamps.argsort(kind="stable"))
            if kind in SERIES:
                rows = self._without_doubles(kind, rows)
            else:
                rows = rows.where(np.append(rows.stamps[1:] != rows.stamps[:-1], True))
        moves = kind in (SpeedReading, BatteryReading)
        self._waiting[kind] = rows if moves else rows.where(slice(-self._most_waiting, None))

    def _without_doubles(self, kind: type[Reading], rows: Rows) -> Rows:
        """Rows with one reading of each stamp; voltage and current may come apart."""
        doubled = np.append(False, rows.stamps[1:] == rows.stamps[:-1])
        first, values = np.flatnonzero(~doubled), rows.values.copy()
        of_first = np.cumsum(~doubled) - 1
        for place in np.flatnonzero(doubled).tolist():
            column = values[:, first[of_first[place]]]
            new = np.isnan(column) & ~np.isnan(rows.values[:, place])
            column[new] = rows.values[new, place]
            if not new[:2].any():
                self.dropped[f"{SERIES[kind]}_doubled"] += 1
        return Rows(rows.order, rows.stamps, values).where(first)

    def _passed(self, watermark_ns: int) -> Block:
        passed = {}
        for kind, rows in self._waiting.items():
            count = int(rows.stamps.searchsorted(watermark_ns, side="right"))
            if count:
                passed[kind] = rows.where(slice(count))
                self._waiting[kind] = rows.where(slice(count, None))
        return Block.sorted(passed)


def in_order(block: Block) -> Block:
    """All possible readings of a recording in order of stamps, however late they came."""
    buffer = ReorderBuffer(WHOLE_RECORDING, block.length)
    buffer.add(block)
    return buffer.flush()
