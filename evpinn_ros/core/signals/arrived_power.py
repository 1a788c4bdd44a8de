"""Power measured by battery readings, in order of arrival."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.block import NO_ROWS
from evpinn_ros.core.signals.power import COARSE
from evpinn_ros.core.signals.readings import BatteryReading, drawn_power
from evpinn_ros.core.signals.reorder import Arrived
from evpinn_ros.core.signals.track import NEVER

MOST_LATEST = 1000  # powers, then the older half is dropped; far more than come between two speeds
NO_BATTERY = Arrived(*NO_ROWS[BatteryReading], np.empty(0, np.int64))


class ArrivedPower(NamedTuple):
    """Powers of n battery readings in order of arrival; a current alone takes the last voltage.

    Attributes:
        battery: the readings.
        power: W, NaN before the first voltage, shape (n,).
        age_ns: age of the voltage, ns, shape (n,).
    """

    battery: Arrived
    power: np.ndarray
    age_ns: np.ndarray

    @property
    def coarse(self) -> np.ndarray:
        """`BatteryReading.power_std` of each, W, shape (n,)."""
        return np.asarray(self.battery.values[COARSE])


NO_POWER = ArrivedPower(NO_BATTERY, *np.empty((2, 0)))


class ArrivedPowerTrack:
    """Follows battery readings in order of arrival."""

    def __init__(self) -> None:
        """Start without a reading."""
        self._voltage, self._voltage_ns = math.nan, NEVER
        self._latest: list[tuple[int, float]] = []  # stamps, rising, and powers, W

    def add_reading(self, reading: BatteryReading) -> tuple[float, int]:
        """Add one reading; returns its power, W, and the age of its voltage, ns."""
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
        for latest in reversed(self._latest):
            if latest[0] < stamp_ns:
                return latest
        return NEVER, math.nan

    def add(self, battery: Arrived = NO_BATTERY) -> ArrivedPower:
        """Add readings in order of arrival; returns their powers."""
        voltage, current = battery.values[:2]
        stamps = battery.stamps
        volts, volts_ns = np.append(self._voltage, voltage), np.append(self._voltage_ns, stamps)
        last = np.maximum.accumulate(np.where(np.isnan(volts), 0, np.arange(len(volts))))
        self._voltage, self._voltage_ns = float(volts[last[-1]]), int(volts_ns[last[-1]])
        volts, age_ns = volts[last[1:]], stamps - volts_ns[last[1:]]
        return ArrivedPower(battery, drawn_power(volts, current), age_ns)

    def before_each(self, speeds: Arrived, arrived: ArrivedPower) -> tuple[np.ndarray, np.ndarray]:
        """`before` for each of n speeds, among the powers that arrived before it; shape (n,) each.

        Keeps the powers of `arrived` for the next call.
        """
        measured = ~np.isnan(arrived.power)
        battery = arrived.battery
        places = np.concatenate((np.full(len(self._latest), -1), battery.order[measured]))
        latest_ns = np.array([stamp_ns for stamp_ns, _ in self._latest], np.int64)
        stamps = np.concatenate((latest_ns, battery.stamps[measured]))
        power = np.concatenate(([watts for _, watts in self._latest], arrived.power[measured]))
        newer = stamps > np.maximum.accumulate(np.append(NEVER, stamps))[:-1]
        places, stamps, power = places[newer], stamps[newer], power[newer]
        last = slice(-MOST_LATEST // 2, None)
        self._latest = [*zip(stamps[last].tolist(), power[last].tolist(), strict=True)]
        # A power counts if it arrived before the speed and is stamped before it: the lesser count.
        which = np.minimum(places.searchsorted(speeds.order), stamps.searchsorted(speeds.stamps))
        return np.append(NEVER, stamps)[which], np.append(np.nan, power)[which]
