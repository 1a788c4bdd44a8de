"""A method of your own against the others: recursive least squares in forty lines.

`evpinn bench unseen bags=tesla_model_3_lr --methods prior,core --method
examples/methods/least_squares.py:LeastSquares`; the interface is `benchmarks.unseen.method`.
"""

from collections.abc import Iterator, Mapping
import math

import numpy as np

from benchmarks.unseen.method import Estimate, Prediction
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.physics import RegenForm

STEP, LONGEST = 1.0, 30.0  # s between two speeds that are joined


def terms(v: float, va: float) -> np.ndarray:
    """Terms of the coefficients, at a speed, m/s, and speed times acceleration, m^2/s^3."""
    return np.array((v, v**3, max(va, 0.0), min(va, 0.0), 1.0))


class LeastSquares:
    """Power as c . (v, v^3, v a driving, v a braking, 1), fitted to all steps so far."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Start as if the car had driven 30 steps with the power of its vehicle file."""
        self._normal, self._target = np.eye(5), np.zeros(5)
        for v in range(0, 30, 5):
            for a in (-1.5, -0.5, 0.0, 0.5, 1.5):
                power = vehicle.power(v, a, vehicle.initial, RegenForm.WHEEL_POWER)
                self._learn(terms(v, v * a), float(power))
        self.begin_next_drive()

    def _learn(self, row: np.ndarray, power: float) -> None:
        self._normal += np.outer(row, row)
        self._target += row * power

    def begin_next_drive(self) -> None:
        """Keep the fit; join nothing to what was before."""
        self._last: SpeedReading | None = None
        self._powers: list[float] = []

    def add_reading(self, reading: Reading) -> Iterator[Prediction]:
        """Predict each step, then learn from it if the battery was measured in it."""
        if isinstance(reading, BatteryReading) and math.isfinite(reading.power):
            self._powers.append(reading.power)
        if not isinstance(reading, SpeedReading):
            return
        last = self._last or reading
        dt = (reading.stamp_ns - last.stamp_ns) / NANOSECONDS
        if STEP <= dt <= LONGEST:
            v, va = (last.speed + reading.speed) / 2, (reading.speed**2 - last.speed**2) / 2 / dt
            row = terms(v, va)
            power = float(row @ np.linalg.solve(self._normal, self._target))
            yield Prediction((last.stamp_ns + reading.stamp_ns) // 2, power)
            if self._powers:
                self._learn(row, float(np.mean(self._powers)))
        if dt >= STEP or self._last is None:
            self._last, self._powers = reading, []

    def combinations(self) -> Mapping[str, Estimate]:
        """Nothing is known of the car's parameters."""
        return {}
