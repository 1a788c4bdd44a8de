"""The parameters of a car, their units, and their priors before driving."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple


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


class Quantity(NamedTuple):
    """How a parameter is shown: word, unit and decimals; and its limits."""

    word: str
    unit: str
    decimals: int
    limits: Limits

    def text(self, value: float) -> str:
        """A value with decimals and unit."""
        return f"{value:.{self.decimals}f} {self.unit}".rstrip()


QUANTITIES = {
    "eta": Quantity("motor efficiency", "", 3, Limits(0.05, 1.0)),
    "mu": Quantity("regeneration", "", 3, Limits(0.0, 1.0)),
    "mass": Quantity("all aboard", "kg", 0, Limits(100.0, 60_000.0)),
    "c_rr": Quantity("rolling", "", 5, Limits(0.001, 0.1)),
    "c_d": Quantity("drag", "", 4, Limits(0.05, 2.0)),
    "p_aux": Quantity("auxiliary", "W", 0, Limits(0.0, 50_000.0)),
}
PARAMETER_NAMES = tuple(QUANTITIES)
LIMITS: Mapping[str, Limits] = {name: shown.limits for name, shown in QUANTITIES.items()}


@dataclass(frozen=True, slots=True)
class Prior:
    """Prior of one parameter before driving: value, 1-sigma and its source."""

    value: float
    std: float
    source: str
