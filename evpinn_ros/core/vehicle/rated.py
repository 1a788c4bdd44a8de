"""Rated cars: priors from curb mass, usable battery and WLTP range.

European road loads are not public, but these three numbers are. Battery divided by range is the
energy per metre of the test cycle, the sum of rolling, drag and losses. The prior of a rated car
is the generic car's, conditioned on these facts (a Kalman update in logarithms), which fix the
mass and the sum. The shares of the sum stay nearly as uncertain as before, so the parameters
become correlated.
"""

from __future__ import annotations

from collections.abc import Mapping
import csv
from dataclasses import dataclass
from functools import cache

import numpy as np

from evpinn_ros.common.package_data import bundled_lines
from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.core.vehicle.certified import FRONTAL_AREA, rounded_prior, words_of
from evpinn_ros.core.vehicle.parameters import Prior
from evpinn_ros.core.vehicle.physics import GRAVITY

TABLE = "config/rated/wltp.csv"
SOURCE = "any car, given curb mass, usable battery and WLTP range"
FACTORS = ("eta", "mu", "mass", "c_rr", "c_d")  # parameters of the cycle's energy
AIR_DENSITY = 1.2  # kg/m^3 at 20 degC
# WLTC class 3b (UN GTR 15), driving and braking: share of the distance; means over the distance of
# speed squared, m^2/s^2, and acceleration, m/s^2. For masses from 1300 to 2500 kg they change by
# 2 % (driving) and 10 % (braking), which is neglected.
DRIVING, BRAKING = (0.768, 442.6, 0.1316), (0.232, 72.0, -0.1316)
# N: 300 W of auxiliary load on a mild day and 300 W for a turning drivetrain, as for certified
# cars, over the 1800 s and 23,266 m of the cycle.
CYCLE_LOAD = 600.0 * 1800.0 / 23266.0
ROTATING = 1.03  # effective over static mass, as for certified cars
PEOPLE = 110.0  # kg above the curb mass, on average: one or two people and a bag
# Computed from certified road loads, the cycle takes 1.10 times the rated energy: the mean of 13
# models that have both, with the 1-sigma of its logarithm.
OPTIMISM, ENERGY_SPREAD = 1.10, 0.10
# 1-sigma of the logarithm: people, luggage, trim, and sources that count a driver of 75 kg.
MASS_SPREAD = 0.06


@dataclass(frozen=True, slots=True)
class RatedCar:
    """One model with its ratings.

    Attributes:
        name: for people, with the model year.
        can_profile: for its bus, None if unknown.
        curb_mass: kg, as listed; some sources include a driver of 75 kg.
        battery: usable energy, J.
        wltp_range: m.
        source: of these numbers.
    """

    name: str
    can_profile: str | None
    curb_mass: float
    battery: float
    wltp_range: float
    source: str

    def given(
        self, priors: Mapping[str, Prior], correlation: np.ndarray
    ) -> tuple[dict[str, Prior], dict[tuple[str, str], float]]:
        """Priors of this car, and their correlations by pairs of names.

        Args:
            priors: of the generic car.
            correlation: of these; the first five rows and columns are `FACTORS`.
        """
        count = len(FACTORS)
        start = np.log([priors[name].value for name in FACTORS])
        std = np.array([priors[name].std / priors[name].value for name in FACTORS])
        before = correlation[:count, :count] * np.outer(std, std)
        facts = np.log([self.curb_mass + PEOPLE, OPTIMISM * self.battery / self.wltp_range])
        noise = np.diag(np.square((MASS_SPREAD, ENERGY_SPREAD)))
        mean = start
        for _ in range(3):  # the energy is not quite linear in logarithms
            expected, rows = _facts(np.exp(mean))
            gain = before @ rows.T @ np.linalg.inv(rows @ before @ rows.T + noise)
            mean = start + gain @ (facts - expected - rows @ (start - mean))
        covariance = before - gain @ rows @ before
        spread = np.sqrt(np.diag(covariance))
        posterior = {
            name: rounded_prior(
                float(np.exp(mean[i])), float(spread[i]), f"{SOURCE}: {self.source}"
            )
            for i, name in enumerate(FACTORS)
        }
        pairs = {
            (FACTORS[i], FACTORS[j]): round(float(covariance[i, j] / spread[i] / spread[j]), 3)
            for i in range(count)
            for j in range(i + 1, count)
        }
        return {**posterior, "p_aux": priors["p_aux"]}, pairs


def cycle_energy(values: np.ndarray) -> float:
    """Energy of the cycle per distance, J/m, for values of `FACTORS`, shape (5,).

    C_d refers to `FRONTAL_AREA`, as in `generic`.
    """
    eta, mu, mass, c_rr, c_d = values
    forces = np.array(
        [c_rr * mass * GRAVITY, 0.5 * AIR_DENSITY * FRONTAL_AREA * c_d, ROTATING * mass]
    )
    return float(forces @ DRIVING / eta + eta * mu * (forces @ BRAKING) + CYCLE_LOAD)


def _facts(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of mass and of the cycle's energy, shape (2,), with gradients, shape (2, 5)."""
    step = 1e-4
    energy = cycle_energy(values)
    moved = values * (1.0 + step * np.eye(len(FACTORS)))
    slopes = [(cycle_energy(car) / energy - 1.0) / step for car in moved]
    rows = np.stack((np.eye(len(FACTORS))[FACTORS.index("mass")], slopes))
    return np.log([values[FACTORS.index("mass")], energy]), rows


@cache
def rated_cars() -> Mapping[str, RatedCar]:
    """Every rated car by its key: lower case, words joined by an underscore."""
    return {
        "_".join(words_of(row["name"])): _car(row) for row in csv.DictReader(bundled_lines(TABLE))
    }


def _car(row: Mapping[str, str]) -> RatedCar:
    return RatedCar(
        name=row["name"],
        can_profile=row["can_profile"] or None,
        curb_mass=float(row["curb_mass_kg"]),
        battery=float(row["battery_kwh"]) * JOULES_PER_KWH,
        wltp_range=float(row["wltp_range_km"]) * 1000.0,
        source=row["source"],
    )
