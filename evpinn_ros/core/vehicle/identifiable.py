"""Combinations of a car's parameters that battery power, speed and grade alone determine.

In the `wheel_power` form of the dynamics eta, mu, mass and C_d enter battery power only through
products, so (eta, mu, mass, C_d) -> (s eta, mu / s, s mass, s C_d) changes nothing that could be
measured. The combinations below are what is left; absolute values need a prior or a known mass.
"""

from __future__ import annotations

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


def identifiable(parameters: Parameters, area: float) -> Identifiable:
    """The identifiable combinations of a full set of parameters; area in m^2."""
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
    relative = {
        name: prior.std / prior.value if prior.value else 0.0
        for name, prior in vehicle.priors.items()
    }
    sigmas = Identifiable(
        mass_over_eta=combined.mass_over_eta * math.hypot(relative["mass"], relative["eta"]),
        drag_area_over_eta=combined.drag_area_over_eta
        * math.hypot(relative["c_d"], relative["eta"]),
        c_rr=vehicle.priors["c_rr"].std,
        regeneration=combined.regeneration * math.hypot(relative["eta"], relative["mu"]),
        p_aux=vehicle.priors["p_aux"].std,
    )
    return combined, sigmas
