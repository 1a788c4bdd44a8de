"""Sorts numeric rows by time and makes blocks of readings from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.core.signals.block import Block, Rows
from evpinn_ros.core.signals.readings import (
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    GradeReading,
    MotorReading,
    Reading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.logs.signal import FloatArray, last_known
from evpinn_ros.logs.source import STRAGGLING_NS

AMBIENT_C = (-60.0, 70.0)  # values outside come from a sensor without a reading

# A value that repeats for longer was measured again, as in steady driving.
LONGEST_HELD_NS = 1_500_000_000
BATTERY = ("voltage", "current", "power", "charge")
# A column of the 12 V load is not listed: it is constant all day, and is learned as such.
LOADS = ("heating", "aircon")
MOST = 1e12  # largest SI value; products of larger ones would overflow

Columns = dict[str, FloatArray]


class RowOrder:
    """Sorts rows by stamp, batch by batch, and drops late rows.

    Attributes:
        dropped: number of rows that were too late, or isolated in the future.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._newest = -1

    def sorted(self, stamps: NDArray[np.int64], rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """Indices of rows in order of time, none older than rows of earlier batches.

        `stamps`, ns, shape (n,), are those of all rows of the batch; `rows` those with a stamp.
        """
        kept = rows[~_alone(stamps[rows])]
        times = stamps[kept]
        newest = np.maximum.accumulate(times) if times.size else times
        late = (times < newest - STRAGGLING_NS) | (times < self._newest)
        kept = kept[~late]
        kept = kept[np.argsort(stamps[kept], kind="stable")]
        if kept.size:
            self._newest = int(stamps[kept[-1]])
        self.dropped += rows.size - kept.size
        return kept


def _alone(times: NDArray[np.int64]) -> NDArray[np.bool_]:
    """True if a row is in the future of both neighbours: one digit of a date is wrong."""
    alone = np.zeros(times.size, dtype=bool)
    if times.size > 2:
        ahead = times[1:-1] - times[2:] > STRAGGLING_NS
        alone[1:-1] = ahead & (times[2:] >= times[:-2])
    return alone


class HeldSignals:
    """Blanks cells that repeat a held value, batch by batch."""

    def __init__(self, names: Iterable[str]) -> None:
        """Begin, for these quantities."""
        self._last: dict[str, tuple[int, float]] = dict.fromkeys(names, (0, np.nan))

    def drop_repeats(
        self, stamps: NDArray[np.int64], values: Mapping[str, FloatArray], rows: NDArray[np.intp]
    ) -> None:
        """Set repeated cells to NaN.

        Args:
            stamps: of all rows of the batch, ns, shape (n,).
            values: of these rows, by quantity, shape (n,) each; modified in place.
            rows: indices of the rows in use, in order of time.
        """
        for name, (since_ns, last) in self._last.items():
            known = rows[~np.isnan(values[name][rows])]
            columns = known.tolist(), stamps[known].tolist(), values[name][known].tolist()
            for row, stamp_ns, value in zip(*columns, strict=True):
                if value == last and stamp_ns - since_ns < LONGEST_HELD_NS:
                    values[name][row] = np.nan
                else:
                    since_ns, last = stamp_ns, value
            self._last[name] = since_ns, last


class RowBlocks:
    """Makes blocks of rows, batch by batch.

    Attributes:
        used: number of rows that gave a reading.
        at_nominal_voltage: number of battery readings of power without a voltage.
    """

    def __init__(self, nominal_voltage: float, dropped: Counter[str]) -> None:
        """Begin; omitted values are counted in `dropped`."""
        self.used = self.at_nominal_voltage = 0
        self._nominal_voltage = nominal_voltage
        self._dropped = dropped
        self._last_ns: dict[str, int] = {}
        self._last_volts = np.nan

    def block(
        self, stamps: NDArray[np.int64], values: Mapping[str, FloatArray], rows: NDArray[np.intp]
    ) -> Block:
        """The readings of some rows, row by row in the order of `_columns`.

        `stamps`, ns, and `values`, SI, NaN if missing, are those of all rows of the batch, shape
        (n,); `rows` are the indices to use, in order of time.
        """
        self._limit(values)
        stamps = stamps[rows]
        columns = {
            kind: (there, fields)
            for kind, there, fields in self._columns(
                stamps, {name: column[rows] for name, column in values.items()}
            )
            if there.any()
        }
        if not columns:
            return Block(0, {})
        has_reading = np.array([there for there, _ in columns.values()]).T
        order = np.cumsum(has_reading).reshape(has_reading.shape) - 1
        self.used += int(has_reading.any(axis=1).sum())
        return Block(
            int(has_reading.sum()),
            {
                kind: Rows(order[there, i], stamps[there], np.array(fields)[:, there])
                for i, (kind, (there, fields)) in enumerate(columns.items())
            },
        )

    def _columns(
        self, stamps: NDArray[np.int64], values: Columns
    ) -> Iterator[tuple[type[Reading], NDArray[np.bool_], tuple[FloatArray, ...]]]:
        """Each kind of reading, the mask of its rows, and its fields, shape (n,) each."""
        empty = np.full(stamps.size, np.nan)

        def rows_of(name: str, *quantities: str) -> NDArray[np.bool_]:
            """Mask of rows with a value of these quantities, newer than the last of `name`."""
            there = np.isfinite([values.get(quantity, empty) for quantity in quantities])
            return self._new(name, stamps, np.asarray(there.any(axis=0)))

        def fields(*quantities: str) -> tuple[FloatArray, ...]:
            return tuple(values.get(quantity, empty) for quantity in quantities)

        if "speed" in values:
            yield SpeedReading, rows_of("speed", "speed"), (values["speed"], empty)
        if values.keys() & {*BATTERY}:
            yield BatteryReading, *self._batteries(stamps, *fields(*BATTERY))
        if "elevation" in values:
            places = fields("elevation", "latitude", "longitude")
            yield AltitudeReading, rows_of("elevation", "elevation"), places
        if "grade" in values:
            yield GradeReading, rows_of("grade", "grade"), fields("grade")
        if "ambient" in values:
            yield TemperatureReading, rows_of("ambient", "ambient"), fields("ambient")
        if values.keys() & {*LOADS}:
            loads = tuple(np.nan_to_num(column) for column in fields(*LOADS))
            yield AuxiliaryReading, rows_of("loads", *LOADS), loads
        if "motor_torque" in values:
            torque = fields("motor_torque", "motor_speed")
            yield MotorReading, rows_of("motor", "motor_torque"), torque

    def _limit(self, values: Mapping[str, FloatArray]) -> None:
        """Remove values that no sensor measures."""
        self._drop(values, "charge", 0.0, 100.0, "soc_pct_out_of_range")
        self._drop(values, "ambient", *AMBIENT_C, "ambient_c_out_of_range")
        if "voltage" in values:
            off = values["voltage"] <= 0  # the sensor is off, and so is its current
            self._dropped["voltage_not_positive"] += int(off.sum())
            for name in ("voltage", "current", "power"):
                if name in values:
                    values[name][off] = np.nan

    def _drop(
        self, values: Mapping[str, FloatArray], name: str, least: float, most: float, why: str
    ) -> None:
        if name in values:
            outside = (values[name] < least) | (values[name] > most)
            self._dropped[why] += int(outside.sum())
            values[name][outside] = np.nan

    def _batteries(
        self,
        stamps: NDArray[np.int64],
        volts: FloatArray,
        amperes: FloatArray,
        power: FloatArray,
        charge: FloatArray,
    ) -> tuple[NDArray[np.bool_], tuple[FloatArray, ...]]:
        """Mask of rows with a reading, and its fields; power gives a missing voltage or current.

        Power becomes current at the last voltage, or at the nominal one before the first.
        """
        from_power = np.isfinite(power) & np.isnan(volts + amperes)
        measured = np.isfinite(volts)
        held = last_known(np.append(self._last_volts, volts))
        self._last_volts = float(held[-1])
        unknown = from_power & np.isnan(held[1:])
        self.at_nominal_voltage += int(unknown.sum())
        volts = np.where(from_power & ~measured, held[1:], volts)
        volts = np.where(unknown, self._nominal_voltage, volts)
        amperes = np.where(from_power, power / volts, amperes)
        used = np.ones(stamps.size, dtype=bool)
        columns = {"voltage": measured, "current": np.isfinite(amperes)}
        for name, there in (columns | {"charge": np.isfinite(charge)}).items():
            used &= ~(used & there) | self._new(name, stamps, used & there)
        used &= np.isfinite([volts, amperes, charge]).any(axis=0)
        return used, (volts, -amperes, charge / 100.0, np.full(stamps.size, np.nan))

    def _new(
        self, name: str, stamps: NDArray[np.int64], there: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Rows with values newer than the last of their name; other values are counted."""
        times = stamps[there]
        later = np.diff(times, prepend=self._last_ns.get(name, -1)) > 0
        self._dropped["time_not_increasing"] += int((~later).sum())
        self._last_ns[name] = max([self._last_ns.get(name, -1), *times[-1:].tolist()])
        new = there.copy()
        new[there] = later
        return new
