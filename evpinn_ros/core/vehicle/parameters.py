"""The parameters of a car, their units, and their priors before driving."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

PARAMETER_NAMES = ("eta", "mu", "mass", "c_rr", "c_d", "p_aux")


class Parameters(NamedTuple):
    """One value of each parameter; floats, arrays or tensors alike."""

    eta: Any  # motor efficiency, battery to wheel, 0..1
    # regeneration efficiency, wheel to battery, 0..1 (see `RegenForm` for the paper's use)
    mu: Any
    mass: Any  # vehicle mass, kg
    c_rr: Any  # coefficient of rolling resistance
    c_d: Any  # coefficient of aerodynamic drag
    p_aux: Any  # auxiliary power, W


class Limits(NamedTuple):
    """Physically possible range of a parameter, both ends included."""

    lower: float
    upper: float


LIMITS: Mapping[str, Limits] = {
    "eta": Limits(0.05, 1.0),
    "mu": Limits(0.0, 1.0),
    "mass": Limits(100.0, 60_000.0),
    "c_rr": Limits(0.001, 0.1),
    "c_d": Limits(0.05, 2.0),
    "p_aux": Limits(0.0, 50_000.0),
}


@dataclass(frozen=True, slots=True)
class Prior:
    """Prior of one parameter before driving: value, 1-sigma and its source."""

    value: float
    std: float
    source: str
