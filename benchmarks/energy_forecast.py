"""Drives of one car in order: each is forecast as a plan before it is driven, then learned from.

The plan holds speed once a second and elevation, nothing else: no heater, no wind, no traffic.
What the car knows of itself then is what it learned on the drives before, and of the day what its
thermometer says before it drives off.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.battery_end import BatteryBenchmark, BatteryRow
from evpinn_ros.common.errors import InputError
from evpinn_ros.energy.driven import drive_plan
from evpinn_ros.energy.forecast import forecast_plan
from evpinn_ros.energy.plan import Plan
from evpinn_ros.energy.power_model import PowerModel, Weather, combined_model
from evpinn_ros.energy.quadrature import EnergyIntegral
from evpinn_ros.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.estimation.worker import Clock, InlineWorker
from evpinn_ros.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    Reading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.signals.road import density_of_air
from evpinn_ros.vehicle.files import Vehicle

MIN_DURATION = 10.0  # s


@dataclass(frozen=True, slots=True)
class PlannedForecast:
    """One drive."""

    measured_j: float  # energy of the battery, J
    forecast_j: float  # before it was driven
    sigma_j: float  # 1-sigma of that
    combinations_j: float  # a forecast that knows the five published combinations alone
    distance_m: float  # m
    battery: BatteryRow | None = None  # at its end, None without a state of charge

    @property
    def error_percent(self) -> float:
        """Of the forecast."""
        return 100.0 * (self.forecast_j - self.measured_j) / abs(self.measured_j)

    @property
    def covered(self) -> bool:
        """True if the 90 % band holds the truth."""
        return abs(self.forecast_j - self.measured_j) <= GAUSSIAN_QUANTILE * self.sigma_j


class ForecastBenchmark:
    """Forecasts drives and learns them, one after the other."""

    def __init__(self, vehicle: Vehicle, clock: Clock) -> None:
        self._vehicle = vehicle
        self._battery = BatteryBenchmark(vehicle)
        self._estimator = OnlineEstimator(vehicle, EstimatorSettings(), InlineWorker(clock))

    def drive(self, readings: Iterable[Reading]) -> PlannedForecast:
        """Forecast a drive, and learn from it.

        Raises:
            InputError: too short to be a drive.
        """
        drive = list(readings)
        plan, measured = driven_plan(drive), _measured(drive)
        self._estimator.begin_next_drive()  # it is another day
        celsius = None
        thermometer = next((r for r in drive if isinstance(r, TemperatureReading)), None)
        if thermometer is not None:
            celsius = thermometer.celsius
            list(self._estimator.add_reading(thermometer))
        known, learned = self._estimator.parameters(), self._estimator.model()
        combinations = combined_model(known.identifiable, known.identifiable_std, self._vehicle)
        model = combinations if learned is None else PowerModel(learned)
        weather = Weather(density_of_air(self._vehicle.air_density, celsius, None), celsius)
        found = forecast_plan(plan, model, weather)
        simple = forecast_plan(plan, combinations, weather)
        for reading in drive:
            for _ in self._estimator.add_reading(reading):
                pass
        distance = float(plan.distance[-1])
        energy, sigma = float(found.energy[-1]), float(found.sigma[-1])
        end = self._battery.drive(drive, found)
        return PlannedForecast(measured, energy, sigma, float(simple.energy[-1]), distance, end)


def driven_plan(readings: Iterable[Reading]) -> Plan:
    """The plan that a drive would have been: speed once a second, and elevation.

    Raises:
        InputError: too short to be a drive.
    """
    speeds, altitudes = [], []
    for reading in readings:
        if isinstance(reading, SpeedReading):
            speeds.append((reading.stamp_ns, reading.speed))
        elif isinstance(reading, AltitudeReading):
            altitudes.append((reading.stamp_ns, reading.altitude))
    if not speeds or speeds[-1][0] - speeds[0][0] < MIN_DURATION * NANOSECONDS:
        raise InputError(f"a drive of less than {MIN_DURATION:g} s is no plan")
    start = speeds[0][0]
    return drive_plan(_series(speeds, start), _series(altitudes, start))


def forecast_totals(drives: Sequence[PlannedForecast]) -> tuple[float, float, int, int] | None:
    """Median and mean absolute error, percent, drives covered and counted, after the first."""
    counted = drives[1:]
    if not counted:
        return None
    errors = [abs(one.error_percent) for one in counted]
    covered = sum(one.covered for one in counted)
    return float(np.median(errors)), float(np.mean(errors)), covered, len(counted)


def _series(rows: list[tuple[int, float]], start: int) -> np.ndarray:
    """Time, s, and value by time, shape (n, 2)."""
    found = [((stamp_ns - start) / NANOSECONDS, value) for stamp_ns, value in rows]
    return np.array(sorted(found, key=lambda row: row[0])).reshape(-1, 2)


def _measured(readings: Iterable[Reading]) -> float:
    integral = EnergyIntegral()
    for reading in readings:
        if isinstance(reading, BatteryReading):
            integral.append(reading.stamp_ns, reading.power)
    return integral.energy
