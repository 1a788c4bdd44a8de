"""Rows of numbers in order of time, and into readings, none older than the last of its kind."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
import math

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.core.signals.readings import (
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    MotorReading,
    Reading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.logs.column import Column
from evpinn_ros.logs.source import STRAGGLING_NS

AMBIENT_C = (-60.0, 70.0)  # what lies outside is no weather but a sensor that says nothing

# A value that repeats longer is taken again, as of a steady car.
LONGEST_HELD_NS = 1_500_000_000
MOST = 1e12  # of anything in SI; beyond, products would be infinite

FloatArray = NDArray[np.float64]
NAN = math.nan
COLUMNS = (
    *("speed", "voltage", "current", "power", "charge"),
    *("elevation", "latitude", "longitude", "ambient"),
    *("heating", "aircon", "auxiliary", "motor_torque", "motor_speed"),
)


class RowOrder:
    """Takes rows batch by batch and gives those that are not too late, by their stamps.

    Attributes:
        dropped: rows that were too late, or alone in the future.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._newest = -1

    def sorted(self, stamps: NDArray[np.int64], rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """Some rows in order, none older than those of the batches before.

        `stamps`, ns, shape (n,), are those of all rows of the batch; `rows` those that have one.
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
    """True if a row is in the future of its neighbours: one broken digit of a date."""
    alone = np.zeros(times.size, dtype=bool)
    if times.size > 2:
        ahead = times[1:-1] - times[2:] > STRAGGLING_NS
        alone[1:-1] = ahead & (times[2:] >= times[:-2])
    return alone


class HeldSignals:
    """Takes repeated cells out of held columns, batch by batch."""

    def __init__(self, names: Iterable[str]) -> None:
        """Begin, for these quantities."""
        self._last: dict[str, tuple[int, float]] = dict.fromkeys(names, (0, np.nan))

    def drop_repeats(
        self, stamps: NDArray[np.int64], values: Mapping[str, FloatArray], rows: NDArray[np.intp]
    ) -> None:
        """Set repeated cells to NaN.

        Args:
            stamps: of all rows of the batch, ns, shape (n,).
            values: of these, by quantity; changed here.
            rows: those that are used, in order of time.
        """
        for name, (since_ns, last) in self._last.items():
            for row in rows.tolist():
                value, stamp_ns = float(values[name][row]), int(stamps[row])
                if value == last and stamp_ns - since_ns < LONGEST_HELD_NS:
                    values[name][row] = np.nan
                elif value == value:
                    since_ns, last = stamp_ns, value
            self._last[name] = since_ns, last


class RowReadings:
    """Makes readings of rows, batch by batch.

    Attributes:
        used: rows that gave a reading.
        at_nominal_voltage: battery readings of power alone.
    """

    def __init__(
        self, rules: Sequence[Column], nominal_voltage: float, dropped: Counter[str]
    ) -> None:
        """Begin; what is left out is counted in `dropped`."""
        self.used = self.at_nominal_voltage = 0
        self._is_sorted = False
        self._nominal_voltage = nominal_voltage
        self._dropped = dropped
        self._last: dict[str, int] = {}
        self._battery = {"voltage", "current", "power", "charge"} & {r.quantity for r in rules}

    def readings(
        self, stamps: NDArray[np.int64], values: Mapping[str, FloatArray], rows: NDArray[np.intp]
    ) -> Iterator[Reading]:
        """The readings of some rows.

        `stamps`, ns, and `values`, SI, NaN where there is none, are those of all rows of the
        batch, shape (n,); `rows` are those to take, in order of time.
        """
        empty = np.full(rows.size, NAN)

        def column(name: str) -> list[float]:
            readings: list[float] = (values[name][rows] if name in values else empty).tolist()
            return readings

        self._limit(values)
        self._is_sorted = self._sorted(stamps[rows])
        table = zip(stamps[rows].tolist(), *map(column, COLUMNS), strict=True)
        for stamp, speed, volt, amp, power, charge, *rest in table:
            *place, warm, heat, cool, aux, torque, turning = rest
            readings: list[Reading] = []
            if speed == speed and self._is_new("speed", stamp):
                readings.append(SpeedReading(stamp, speed))
            if self._battery and (battery := self._of_battery(stamp, volt, amp, power, charge)):
                readings.append(battery)
            if place[0] == place[0] and self._is_new("elevation", stamp):
                readings.append(AltitudeReading(stamp, *place))
            if warm == warm and self._is_new("ambient", stamp):
                readings.append(TemperatureReading(stamp, warm))
            if (heat == heat or cool == cool or aux == aux) and self._is_new("loads", stamp):
                others = (cool if cool == cool else 0.0) + (aux if aux == aux else 0.0)
                readings.append(AuxiliaryReading(stamp, heat if heat == heat else 0.0, others))
            if torque == torque and self._is_new("motor", stamp):
                readings.append(MotorReading(stamp, torque, turning))
            self.used += bool(readings)
            yield from readings

    def _sorted(self, stamps: NDArray[np.int64]) -> bool:
        """True if each row is later than all before it, so that none needs to be asked."""
        newest = max(self._last.values(), default=-1)
        in_order = stamps.size > 0 and stamps[0] > newest and bool((np.diff(stamps) > 0).all())
        if in_order:
            self._last = dict.fromkeys((*self._last, "newest"), int(stamps[-1]))
        return in_order

    def _limit(self, values: Mapping[str, FloatArray]) -> None:
        """Take out what no sensor measures."""
        self._drop(values, "charge", 0.0, 100.0, "soc_pct_out_of_range")
        self._drop(values, "ambient", *AMBIENT_C, "ambient_c_out_of_range")
        if "voltage" in values:
            off = values["voltage"] <= 0  # a sensor that is off: its current is none either
            self._dropped["voltage_not_positive"] += int(off.sum())
            for name in ("voltage", "current", "power"):
                if name in values:
                    values[name][off] = NAN

    def _drop(
        self, values: Mapping[str, FloatArray], name: str, least: float, most: float, why: str
    ) -> None:
        if name in values:
            outside = (values[name] < least) | (values[name] > most)
            self._dropped[why] += int(outside.sum())
            values[name][outside] = NAN

    def _of_battery(
        self, stamp: int, volt: float, amp: float, power: float, charge: float
    ) -> BatteryReading | None:
        """Voltage and current as measured; where one is missing, the current from power."""
        if power == power and not (volt == volt and amp == amp):
            if volt != volt:
                volt = self._nominal_voltage
                self.at_nominal_voltage += 1
            amp = power / volt if abs(power) < MOST else NAN
        if volt != volt and amp != amp and charge != charge:
            return None
        for name, value in (("voltage", volt), ("current", amp), ("charge", charge)):
            if value == value and not self._is_new(name, stamp):
                return None
        return BatteryReading(stamp, volt, -amp if amp == amp else NAN, charge / 100)

    def _is_new(self, name: str, stamp: int) -> bool:
        """True if it is later than the last of its kind; those that are not are counted."""
        if self._is_sorted:
            return True
        if stamp <= self._last.get(name, -1):
            self._dropped["time_not_increasing"] += 1
            return False
        self._last[name] = stamp
        return True
