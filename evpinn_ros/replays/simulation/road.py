"""A road of smooth hills: elevation and slope along the distance driven."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evpinn_ros.common.errors import InputError

SHORTEST_HILL, LONGEST_HILL = 250.0, 5000.0  # m, wavelengths
HILLS = 12
MAX_RMS_GRADE = 0.05


@dataclass(frozen=True, slots=True)
class HillyRoad:
    """Sum of sinusoidal hills, elevation zero at the start."""

    wave_number: np.ndarray  # shape (HILLS,), rad/m
    slope: np.ndarray  # shape (HILLS,), amplitude of the slope of each hill, 1
    phase: np.ndarray  # shape (HILLS,), rad

    def elevation(self, distance: np.ndarray) -> np.ndarray:
        """Elevation above the start, m, at distances along the road of shape (n,), m."""
        height = self.slope / self.wave_number
        waves = np.sin(np.outer(distance, self.wave_number) + self.phase) - np.sin(self.phase)
        return np.asarray(waves @ height)

    def mean_slope(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Climb per metre along the road from `start` to `end`, both of shape (n,), m.

        Exact also where both are the same point, so that slope times distance is the climb.
        """
        middle = np.outer((start + end) / 2, self.wave_number) + self.phase
        half_turns = np.outer(end - start, self.wave_number) / (2 * np.pi)
        return np.asarray((np.cos(middle) * np.sinc(half_turns)) @ self.slope)


def hilly_road(rms_grade: float, rng: np.random.Generator) -> HillyRoad:
    """A random road whose slope has this root mean square, 1; zero is a flat road.

    Peaks are about three times as steep. The hills get slopes of equal weight, so the long ones
    carry the height.

    Raises:
        InputError: the grade is outside [0, MAX_RMS_GRADE].
    """
    if not 0 <= rms_grade <= MAX_RMS_GRADE:
        raise InputError(f"rms grade {rms_grade:g} is outside [0, {MAX_RMS_GRADE:g}]")
    wavelength = np.exp(rng.uniform(np.log(SHORTEST_HILL), np.log(LONGEST_HILL), HILLS))
    slope = np.full(HILLS, rms_grade * np.sqrt(2 / HILLS))
    return HillyRoad(2 * np.pi / wavelength, slope, rng.uniform(0, 2 * np.pi, HILLS))
