"""Wind and auxiliary loads of a drive, and the smooth noise of these and of traffic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from evpinn_ros.core.signals.road import GAS_CONSTANT


def slow_noise(time: np.ndarray, memory: float, rng: np.random.Generator) -> np.ndarray:
    """Smooth noise of unit variance at times, s, (n,): a spline of values every `memory` s."""
    knots = np.arange(0.0, time[-1] + 4 * memory, memory)
    return np.asarray(CubicSpline(knots, rng.standard_normal(knots.size))(time))


WIND_SPREAD = 1.2  # m/s, 1-sigma of the head wind as the road turns and shelters
WIND_MEMORY = 25.0  # s
PRESSURE = 101_325.0  # Pa
FREEZING = 273.15  # K


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Series of shape (n,): head wind, m/s, and auxiliary load over its mean, 1."""

    head_wind: np.ndarray
    auxiliary: np.ndarray


def draw_surroundings(time: np.ndarray, rng: np.random.Generator) -> Surroundings:
    """Wind and auxiliary loads at evenly spaced times, s, of shape (n,)."""
    wind = WIND_SPREAD * slow_noise(time, WIND_MEMORY, rng)
    steady = 1.0 + 0.02 * slow_noise(time, 2.0, rng)
    load = steady + _compressor(time, rng) + _heater(time, rng)
    return Surroundings(wind, load / load.mean())


def ambient_celsius(air_density: float) -> float:
    """Temperature, degrees Celsius, of dry air of this density, kg/m^3, at sea level."""
    return PRESSURE / (GAS_CONSTANT * air_density) - FREEZING


def _compressor(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    period, duty = rng.uniform(60.0, 120.0), rng.uniform(0.3, 0.6)
    phase = (time / period + rng.uniform()) % 1.0
    return _soft(0.25 * (phase < duty), time)


def _heater(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    changes = np.sort(rng.uniform(0.0, time[-1], 2))
    levels = rng.uniform(0.0, 0.3, 3)
    return _soft(levels[np.searchsorted(changes, time)], time)


def _soft(steps: np.ndarray, time: np.ndarray) -> np.ndarray:
    return np.asarray(gaussian_filter1d(steps, 0.25 / (time[1] - time[0]), mode="nearest"))
