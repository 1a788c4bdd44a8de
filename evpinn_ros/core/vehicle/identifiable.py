"""Combinations of a car's parameters that battery power, speed and grade alone determine.

In the `wheel_power` form of the dynamics eta, mu, mass and C_d enter battery power only through
products, so (eta, mu, mass, C_d) -> (s eta, mu / s, s mass, s C_d) changes nothing that could be
measured. The combinations below are what is left; absolute values need a prior or a known mass.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any, NamedTuple

from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.parameters import Parameters


class Identifiable(NamedTuple):
    """The combinations that data determine; floats, arrays or tensors alike."""

    mass_over_eta: Any  # m / eta, kg
    drag_area_over_eta: Any  # A C_d / eta, m^2
    c_rr: Any  # coefficient of rolling resistance
    regeneration: Any  # eta mu, share of the braking energy counted at the battery, 0..1
    p_aux: Any  # auxiliary power, W


IDENTIFIABLE_NAMES = Identifiable._fields
POWERS: Mapping[str, Mapping[str, float]] = {
    "mass_over_eta": {"mass": 1.0, "eta": -1.0},
    "drag_area_over_eta": {"c_d": 1.0, "eta": -1.0},
    "c_rr": {"c_rr": 1.0},
    "regeneration": {"eta": 1.0, "mu": 1.0},
    "p_aux": {"p_aux": 1.0},
}
"""Exponents of the parameters in each combination."""


def identifiable(parameters: Parameters, area: float) -> Identifiable:
    """The identifiable combinations of a set of parameters; frontal area in m^2."""
    return Identifiable(
        mass_over_eta=parameters.mass / parameters.eta,
        drag_area_over_eta=area * parameters.c_d / parameters.eta,
        c_rr=parameters.c_rr,
        regeneration=parameters.eta * parameters.mu,
        p_aux=parameters.p_aux,
    )


def prior_identifiable(vehicle: Vehicle) -> tuple[Identifiable, Identifiable]:
    """The combinations of the vehicle's priors, and their 1-sigma to first order.

    Relative variances of products and quotients of independent quantities add up.
    """
    combined = identifiable(vehicle.initial, vehicle.frontal_area)
    sigmas = []
    for value, powers in zip(combined, POWERS.values(), strict=True):
        priors = [vehicle.priors[name] for name in powers]
        share = math.hypot(*(prior.std / prior.value for prior in priors if prior.value))
        sigmas.append(value * share if value else priors[0].std)
    return combined, Identifiable(*sigmas)
