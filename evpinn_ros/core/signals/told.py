"""Power that the battery readings measure, in the order in which they come."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.block import FIELDS, NO_ROWS
from evpinn_ros.core.signals.readings import BatteryReading, drawn_power
from evpinn_ros.core.signals.reorder import Arrived
from evpinn_ros.core.signals.track import NEVER

MOST_LATEST = 1000  # powers, of which half are kept: far more than come between two speeds
NO_BATTERY = Arrived(*NO_ROWS[BatteryReading], np.empty(0, np.int64))
COARSE = FIELDS[BatteryReading].index("power_std")


class ToldPower(NamedTuple):
    """Powers of n battery readings as they came; of a current alone, with the last voltage.

    Attributes:
        order: their places among all readings of the block, shape (n,).
        stamps: ns, shape (n,).
        power: W, NaN where no voltage was told before, shape (n,).
        age_ns: of the voltage, shape (n,).
        coarse: W, 1-sigma where it is not the sensor's own, shape (n,).
        watermark_ns: the watermark before each came, shape (n,).
    """

    order: np.ndarray
    stamps: np.ndarray
    power: np.ndarray
    age_ns: np.ndarray
    coarse: np.ndarray
    watermark_ns: np.ndarray


NOTHING = np.empty(0)
NOTHING_TOLD = ToldPower(
    NO_BATTERY.order, NO_BATTERY.stamps, NOTHING, NOTHING, NOTHING, NO_BATTERY.watermark_ns
)


class ToldTrack:
    """Follows the battery as it comes."""

    def __init__(self) -> None:
        """Nothing told."""
        self._voltage, self._voltage_ns = math.nan, NEVER
        self._latest: list[tuple[int, float]] = []  # stamps, rising, and powers, W

    def add_reading(self, reading: BatteryReading) -> tuple[float, int]:
        """Take one reading as it comes: its power, W, and the age of its voltage, ns."""
        if reading.voltage == reading.voltage:
            self._voltage, self._voltage_ns = reading.voltage, reading.stamp_ns
        power = drawn_power(self._voltage, reading.current)
        if power == power and (not self._latest or reading.stamp_ns > self._latest[-1][0]):
            self._latest.append((reading.stamp_ns, power))
            if len(self._latest) > MOST_LATEST:
                del self._latest[: -MOST_LATEST // 2]
        return power, reading.stamp_ns - self._voltage_ns

    def before(self, stamp_ns: int) -> tuple[int, float]:
        """The newest power stamped before a moment, ns and W; `NEVER` and NaN before any."""
        for told in reversed(self._latest):
            if told[0] < stamp_ns:
                return told
        return NEVER, math.nan

    def add(self, battery: Arrived = NO_BATTERY) -> ToldPower:
        """Take readings as they come."""
        voltage, current = battery.values[:2]
        stamps = battery.stamps
        volts, volts_ns = np.append(self._voltage, voltage), np.append(self._voltage_ns, stamps)
        last = np.maximum.accumulate(np.where(np.isnan(volts), 0, np.arange(len(volts))))
        self._voltage, self._voltage_ns = float(volts[last[-1]]), int(volts_ns[last[-1]])
        volts, age_ns = volts[last[1:]], stamps - volts_ns[last[1:]]
        power = drawn_power(volts, current)
        coarse = battery.values[COARSE]
        return ToldPower(battery.order, stamps, power, age_ns, coarse, battery.watermark_ns)

    def before_each(
        self, order: np.ndarray, stamps: np.ndarray, told: ToldPower
    ) -> tuple[np.ndarray, np.ndarray]:
        """As `before`, for each of n moments, of what had come by then; shape (n,) each.

        Args:
            order: places of the moments among all readings of the block, shape (n,).
            stamps: of the moments, ns, shape (n,).
            told: the powers of this block, which are the latest from here on.
        """
        known = ~np.isnan(told.power)
        places = np.concatenate((np.full(len(self._latest), -1), told.order[known]))
        latest = np.array(self._latest or np.empty((0, 2)), dtype=object).reshape(-1, 2)
        told_ns = np.concatenate((latest[:, 0].astype(np.int64), told.stamps[known]))
        power = np.concatenate((latest[:, 1].astype(float), told.power[known]))
        newer = told_ns > np.maximum.accumulate(np.append(NEVER, told_ns))[:-1]
        places, told_ns, power = places[newer], told_ns[newer], power[newer]
        kept = slice(-MOST_LATEST // 2, None)
        self._latest = [*zip(told_ns[kept].tolist(), power[kept].tolist(), strict=True)]
        which = np.minimum(places.searchsorted(order), told_ns.searchsorted(stamps))
        return np.append(NEVER, told_ns)[which], np.append(np.nan, power)[which]
