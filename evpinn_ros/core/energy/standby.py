"""Measured power while the estimator is away: voltage times current of the battery itself."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
import math
from typing import NamedTuple

from evpinn_ros.core.signals.readings import BatteryReading, sensor_sigma

AWAY = 2.0  # s of the monotonic clock without a message of the estimator
MOST_WAITING = 10_000  # readings


class MeasuredPower(NamedTuple):
    """Power of the battery, W, at a stamp, with its 1-sigma, W."""

    stamp_ns: int
    power: float
    sigma: float


class Standby:
    """Keeps battery readings that the estimator may have missed."""

    def __init__(self, now: float) -> None:
        """Start as if the estimator had just sent a message; now: s of the monotonic clock."""
        self._heard, self._waiting = now, deque[BatteryReading](maxlen=MOST_WAITING)

    def hear(self, stamp_ns: int, now: float) -> list[MeasuredPower]:
        """Take a stamp of the estimator; returns the power that it missed while away."""
        away, self._heard = now - self._heard > AWAY, now
        missed: list[BatteryReading] = []
        if away:
            missed = [reading for reading in self._waiting if reading.stamp_ns < stamp_ns]
        while self._waiting and self._waiting[0].stamp_ns <= stamp_ns:
            self._waiting.popleft()
        return [*_powers(missed)]

    def take(self, reading: BatteryReading, now: float) -> list[MeasuredPower]:
        """Take a reading; returns the power of all waiting ones while the estimator is away."""
        self._waiting.append(reading)
        if now - self._heard <= AWAY:
            return []
        missed = [*self._waiting]
        self._waiting.clear()
        return [*_powers(missed)]


def _powers(readings: list[BatteryReading]) -> Iterator[MeasuredPower]:
    for reading in readings:
        if not math.isnan(power := reading.power):
            sigma = float(sensor_sigma(power, reading.power_std))
            yield MeasuredPower(reading.stamp_ns, power, sigma)
