"""Mechanical power of the motor, where a bus reports its torque."""

from __future__ import annotations

import math

import numpy as np

from evpinn_ros.signals.readings import NANOSECONDS, MotorReading
from evpinn_ros.signals.track import SignalTrack

NOMINAL_RATIO = 27.0  # rad/m: a gear of 9 and tyres that roll on 0.33 m


class MotorTrack:
    """Power at the motor shaft over the latest seconds, W, positive when it drives.

    Attributes:
        scaled: whether it is in W; else up to a factor, for neither gear nor speed is known.
    """

    def __init__(self, max_gap: float, ratio: float) -> None:
        """Take the motor's turning from its own speed, else from the car's.

        Args:
            max_gap: s, see `battery.Cadence`.
            ratio: rad that the motor turns per m of road; `NOMINAL_RATIO` where it is NaN.
        """
        self._power = SignalTrack(max_gap)
        self.scaled = not math.isnan(ratio)
        self._ratio = ratio if self.scaled else NOMINAL_RATIO

    def add(self, reading: MotorReading, car_speed: float) -> None:
        """Take a reading at a speed of the car, m/s."""
        known = not math.isnan(reading.speed)
        self.scaled = self.scaled or known
        turning = reading.speed if known else self._ratio * car_speed
        self._power.add(reading.stamp_ns, reading.torque * turning)

    def at(self, stamp_ns: int) -> float:
        """Power at a moment, W, that of the last reading where it is the newest; NaN unknown."""
        stamps = self._power.stamps
        if stamps and 0 <= stamp_ns - stamps[-1] <= self._power.cadence.gap_ns:
            return self._power.values[-1]
        found = self._power.at(stamp_ns)
        return math.nan if found is None else found

    def energy(self, start_ns: int, end_ns: int) -> tuple[float, float]:
        """Energy of driving and of braking between two moments, positive J; NaN where unknown."""
        if not self._power.covers(start_ns, end_ns):
            return math.nan, math.nan
        stamps = [start_ns, *self._power.within(start_ns, end_ns), end_ns]
        power = np.array([self._power.at(stamp_ns) for stamp_ns in stamps], float)
        step = np.diff(stamps) / NANOSECONDS
        drive, brake = np.maximum(power, 0.0), np.maximum(-power, 0.0)
        return float((drive[1:] + drive[:-1]) @ step) / 2, float(
            (brake[1:] + brake[:-1]) @ step
        ) / 2
