"""Drives of one car in order, each forecast from speed without its battery, then learned from.

What is learned is carried over from drive to drive as it is on board; what a drive costs is
predicted by a car that has never seen it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.online import Predictions
from evpinn_ros.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.estimation.worker import Clock, InlineWorker
from evpinn_ros.replays.history import History
from evpinn_ros.replays.scoring import drive_scores
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.vehicle.files import Vehicle


@dataclass(frozen=True, slots=True)
class CarriedForecast:
    """One drive, forecast. Powers in W, energy in J; None where nothing was measured."""

    rmse_w: float | None
    coverage_90: float | None
    measured_j: float | None
    predicted_j: float | None
    error_percent: float | None


class CarriedBenchmark:
    """Forecasts drives and learns them, one after the other."""

    def __init__(self, vehicle: Vehicle, clock: Clock, *, speed_only: bool) -> None:
        """Start at the vehicle's priors; `speed_only` hides grade, temperature and loads."""
        self._vehicle, self._clock, self._speed_only = vehicle, clock, speed_only
        self._learned: dict[str, Any] | None = None

    def drive(self, readings: Callable[[], Iterable[Reading]]) -> CarriedForecast:
        """Forecast a drive, whose readings can be had twice, and learn from it."""
        found = self._forecast(self._seen(readings()))
        self._learn(self._seen(readings()))
        return found

    def _seen(self, readings: Iterable[Reading]) -> Iterator[Reading]:
        for reading in readings:
            if not self._speed_only or isinstance(reading, (SpeedReading, BatteryReading)):
                yield reading

    def _forecast(self, readings: Iterable[Reading]) -> CarriedForecast:
        estimator, history, predictions = self._estimator(), History(), Predictions()
        for reading in readings:
            history.add_reading(reading)
            if isinstance(reading, BatteryReading):
                continue
            for output in estimator.add_reading(reading):
                if isinstance(output, PowerEstimate) and output.kind is PowerKind.SMOOTHED:
                    stamp_ns = output.stamp_ns
                    lag = (reading.stamp_ns - stamp_ns) / NANOSECONDS
                    time = history.seconds(stamp_ns)
                    predictions.add(output.kind, stamp_ns, time, output.power, output.sigma, lag)
        scores = drive_scores(predictions.over(history.drive()), warm_up=0.0)
        power, energy = scores["power"], scores["energy"]
        return CarriedForecast(
            power["rmse_w"],
            power["coverage_90"],
            energy["measured_j"],
            energy["predicted_j"],
            energy["error_percent"],
        )

    def _learn(self, readings: Iterable[Reading]) -> None:
        estimator = self._estimator()
        for reading in readings:
            for _ in estimator.add_reading(reading):
                pass
        self._learned = estimator.export()

    def _estimator(self) -> OnlineEstimator:
        """An estimator that knows all drives so far."""
        worker = InlineWorker(self._clock)
        estimator = OnlineEstimator(self._vehicle, EstimatorSettings(), worker)
        if self._learned is not None:
            estimator.restore(self._learned)
        return estimator


def energy_errors(drives: Iterable[CarriedForecast]) -> tuple[float, float] | None:
    """Median and mean of the absolute energy errors, percent, of the drives after the first.

    Before the first nothing is known of the car. None without any.
    """
    known = [one.error_percent for one in list(drives)[1:] if one.error_percent is not None]
    errors = np.abs(known)
    return (float(np.median(errors)), float(np.mean(errors))) if known else None
