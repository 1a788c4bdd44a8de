"""Forecast of the loads that a car reports, its heater and air conditioning.

At an ambient temperature T, a time t into a drive, the mean load is

    base + (heating + heating_first e) max(0, 20 - T) + (cooling + cooling_first e) max(0, T - 20)

with e = exp(-t / SETTLING), plus what is of this drive: a driver's habit, the sun, the windows.

The prior is that of a small car with an electric heater: some 60 W/K through its walls and for
fresh air, about half of that for cooling with a coefficient of performance of 2, and more than
twice as much until the cabin is warm: 5 kW at first and 2 kW later at -7 degrees, as drivers and
Argonne's tests of a Nissan Leaf (Lohse-Busch et al., SAE 2013-01-1462) have it. Drives that were
driven move it, each as one observation of its mean load, for what is of a drive stays for it.
Until a car has reported any load at all none is expected: then they are part of its auxiliary
power.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Annotated, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.estimation.calibration import MOST_SUM
from evpinn_ros.signals.road import HEATED_BELOW

PRIOR = np.array([300.0, 60.0, 80.0, 30.0, 50.0])  # W and W/K, in the order of the text above
PRIOR_STD = np.array([200.0, 30.0, 40.0, 30.0, 30.0])
DRIVE_STD = 1000.0  # W, of what is of one drive
SETTLING = 600.0  # s in which a cabin gets warm, and a drive shows its own
MOST = 1e6  # W


class ExpectedLoads(NamedTuple):
    """Loads to come: once all has settled, their 1-sigma, and how much more it is now, W."""

    settled: float
    sigma: float
    excess: float


@dataclass(frozen=True, slots=True)
class SavedLoads:
    """The five coefficients, and of this drive its seconds, energy and sums of features."""

    mean: Annotated[np.ndarray, Range(-MOST, MOST)]
    covariance: Annotated[np.ndarray, Range(-(MOST**2), MOST**2)]
    reported: bool
    drive: Annotated[np.ndarray, Range(0.0, MOST_SUM)]

    def __post_init__(self) -> None:
        """Refuse a covariance that is none."""
        if np.linalg.eigvalsh(self.covariance).min() < -1e-6:
            raise ValueError("the loads have no such covariance")


class ReportedLoads(Saveable[SavedLoads]):
    """Learns from drive to drive; see the module's text."""

    def __init__(self) -> None:
        """Start at the prior."""
        self._mean, self._covariance = PRIOR.copy(), np.diag(PRIOR_STD**2)
        self._reported = False
        self._present = 0.0
        self._begin_drive()

    @property
    def reports(self) -> bool:
        """True once the car has reported a load."""
        return self._reported

    def add(self, load: float, celsius: float | None, step: float) -> None:
        """Take a load, W, that stands for `step` seconds at an ambient temperature."""
        self._reported = self._reported or load > 0.0
        self._features += step * _features(celsius, self._seconds)
        self._energy += step * load
        self._seconds += step
        self._present = load

    def end_drive(self) -> None:
        """Learn from the drive that was; the next is another."""
        if self._reported:
            mean, covariance = self._with_drive()
            self._mean, self._covariance = mean[:-1], covariance[:-1, :-1]
        self._begin_drive()

    def expected(self, celsius: float | None) -> ExpectedLoads:
        """Expected load at an ambient temperature from now on."""
        if not self._reported:
            return ExpectedLoads(0.0, 0.0, 0.0)
        mean, covariance = self._with_drive()
        later, first = (np.append(_features(celsius, t), 1.0) for t in (math.inf, 0.0))
        settled = max(0.0, float(later @ mean))
        now = self._present if self._seconds else max(0.0, float(first @ mean))
        return ExpectedLoads(settled, math.sqrt(later @ covariance @ later), now - settled)

    def saved(self) -> SavedLoads:
        """State to save."""
        drive = np.array([self._seconds, self._energy, *self._features])
        return SavedLoads(self._mean, self._covariance, self._reported, drive)

    def take(self, saved: SavedLoads) -> None:
        """Go on from saved loads."""
        self._mean, self._covariance = saved.mean, saved.covariance
        self._reported = saved.reported
        self._seconds, self._energy = map(float, saved.drive[:2])
        self._features = saved.drive[2:]
        self._present = self._energy / max(self._seconds, 1.0)

    def _begin_drive(self) -> None:
        self._seconds = self._energy = 0.0
        self._features = np.zeros(PRIOR.size)

    def _with_drive(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of the five and of what is of this drive, by its mean load so far.

        The variance of a drive's mean falls with the length driven.
        """
        mean, covariance = np.append(self._mean, 0.0), np.zeros((6, 6))
        covariance[:-1, :-1], covariance[-1, -1] = self._covariance, DRIVE_STD**2
        if self._seconds == 0.0:
            return mean, covariance
        features = np.append(self._features / self._seconds, 1.0)
        along = covariance @ features
        variance = features @ along + DRIVE_STD**2 * SETTLING / self._seconds
        innovation = self._energy / self._seconds - features @ mean
        gain = along / variance
        return mean + gain * innovation, covariance - np.outer(gain, along)


def _features(celsius: float | None, seconds: float) -> np.ndarray:
    """Features of the five coefficients; an unknown temperature counts as a mild day."""
    away = 0.0 if celsius is None else celsius - HEATED_BELOW
    cold, warm, first = max(0.0, -away), max(0.0, away), math.exp(-seconds / SETTLING)
    return np.array([1.0, cold, cold * first, warm, warm * first])
