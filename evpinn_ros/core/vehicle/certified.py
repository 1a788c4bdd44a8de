"""Cars with a certified road load (US EPA), and their priors.

A certificate gives the coastdown force, a + b v + c v^2, and the test mass. Rolling resistance and
drag are the constant and quadratic coefficients that fit this force best over the speeds of a
coastdown: within 1.9 % (root mean square) for a usual car, 4.1 % for the worst. Certificates hold
no efficiencies; these follow from the energies of the same tests. With a charging loss of 12 %,
300 W of auxiliary load and 300 W for a turning drivetrain, the two cycles of 71 cars give medians
of 0.91 (eta) and 0.80 (mu), with a spread of 0.05 and 0.14.
"""

from __future__ import annotations

from collections.abc import Mapping
import csv
from dataclasses import dataclass
from functools import cache
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.common.package_data import bundled_lines
from evpinn_ros.core.vehicle.parameters import Prior
from evpinn_ros.core.vehicle.physics import GRAVITY

TABLE = "config/certified/epa_2022.csv"
SOURCE = "US EPA test car list 2022"
AIR_DENSITY = 1.167  # kg/m^3 of a certified road load: 20 degC and 98.21 kPa (SAE J1263)
COASTDOWN_SPEEDS = np.arange(4.0, 32.5, 0.5)  # m/s: 115 to 15 km/h
FRONTAL_AREA = 2.3  # m^2, not certified: only A C_d is

# Relative 1-sigma of a car around its certificate: one to four people and luggage; other tyres,
# inflation, road; a roof box, wheels, an open window.
MASS_SPREAD, ROLLING_SPREAD, DRAG_SPREAD = 0.06, 0.15, 0.06
DRIVETRAIN = {
    "eta": Prior(0.9, 0.06, f"{SOURCE}: energies of two cycles, 12 % lost in charging"),
    "mu": Prior(0.8, 0.12, f"{SOURCE}: energies of two cycles, 12 % lost in charging"),
    "p_aux": Prior(
        400.0, 400.0, "computers, lights, pumps on a mild day; spread: what else is on"
    ),
}


class RoadLoad(NamedTuple):
    """Force on a rolling car: `constant` + `linear` v + `square` v^2, N and m/s; mass, kg."""

    mass: float
    constant: float
    linear: float
    square: float

    def force(self, speed: np.ndarray) -> np.ndarray:
        """N at speeds, m/s."""
        return self.constant + self.linear * speed + self.square * speed**2

    @property
    def physics(self) -> tuple[float, float, float]:
        """Mass, kg, c_rr and drag area, m^2, by least squares of the relative error of force."""
        columns = np.stack((np.ones_like(COASTDOWN_SPEEDS), COASTDOWN_SPEEDS**2), axis=1)
        shares = columns / self.force(COASTDOWN_SPEEDS)[:, None]
        rolling, drag = np.linalg.lstsq(shares, np.ones(len(shares)), rcond=None)[0]
        return self.mass, float(rolling) / (self.mass * GRAVITY), 2.0 * float(drag) / AIR_DENSITY


@dataclass(frozen=True, slots=True)
class CertifiedCar:
    """One model, with a road load for each of its certified tyres and batteries."""

    name: str  # for people, with the model year
    can_profile: str | None  # for its bus, if any is known
    loads: tuple[RoadLoad, ...]  # at least one
    udds: float  # at the wall, Wh/km; NaN where it is not known
    highway: float  # at the wall, Wh/km; NaN where it is not known
    pack_of: str  # key of a car with the same battery, or empty

    @property
    def priors(self) -> Mapping[str, Prior]:
        """Prior of every parameter, around the geometric mean of the road loads."""
        logs = np.log([load.physics for load in self.loads])
        mass, c_rr, area = np.exp(logs.mean(axis=0))
        spread = np.hypot((MASS_SPREAD, ROLLING_SPREAD, DRAG_SPREAD), logs.std(axis=0))
        origin = f"{SOURCE}: road load"
        return {
            "eta": DRIVETRAIN["eta"],
            "mu": DRIVETRAIN["mu"],
            "mass": rounded_prior(mass, spread[0], f"{SOURCE}: test mass; spread: payload"),
            "c_rr": rounded_prior(c_rr, spread[1], f"{origin}; spread: tyres and roads"),
            "c_d": rounded_prior(
                area / FRONTAL_AREA, spread[2], f"{origin}; only A C_d is certified"
            ),
            "p_aux": DRIVETRAIN["p_aux"],
        }


def rounded_prior(value: float, share: float, source: str) -> Prior:
    """A prior with a relative 1-sigma, rounded to four significant digits of the value."""
    digits = 3 - math.floor(math.log10(value))
    return Prior(round(float(value), digits), round(float(value * share), digits), source)


@cache
def certified_cars() -> Mapping[str, CertifiedCar]:
    """Every certified car by its key: lower case, words joined by an underscore."""
    rows = list(csv.DictReader(bundled_lines(TABLE)))
    cars = {}
    for name in dict.fromkeys(row["name"] for row in rows):
        tests = [row for row in rows if row["name"] == name]
        cars["_".join(words_of(name))] = CertifiedCar(
            name,
            tests[0]["can_profile"] or None,
            tuple(_load(row) for row in tests),
            _mean(tests, "udds_wh_per_km"),
            _mean(tests, "highway_wh_per_km"),
            tests[0]["pack_of"],
        )
    return cars


def _load(row: Mapping[str, str]) -> RoadLoad:
    names = ("test_mass_kg", "a_n", "b_n_per_mps", "c_n_per_mps2")
    return RoadLoad(*(float(row[name]) for name in names))


def _mean(rows: list[dict[str, str]], name: str) -> float:
    values = [float(row[name]) for row in rows if row[name]]
    return sum(values) / len(values) if values else math.nan


def words_of(text: str) -> list[str]:
    """Words and numbers of a name, lower case: "Model 3 (Long-Range)" has four."""
    return "".join(c if c.isalnum() else " " for c in text.lower()).split()
