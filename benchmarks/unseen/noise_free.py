"""Truth of a car whose power is known without noise: what its own trace determines.

These are the coefficients of eq. 21, by least squares with the simulator's own speed, acceleration
and slope while its wheels are driven, and the share of the braking energy so counted that came
back; p_aux is what a standing car draws. The parameters of a simulator's file over a mean eta are
no such truth: what a map of losses takes without torque is a force, and no battery tells it apart
from that of the tyres.
"""

from __future__ import annotations

import numpy as np


def combinations_of(
    terms: np.ndarray, power: np.ndarray, wheel: np.ndarray, p_aux: float
) -> dict[str, float]:
    """The combinations by `method.NAMES`.

    Args:
        terms: what m/eta, C_rr m/eta, A C_d/eta and a constant are multiplied with, shape (4, n).
        power: of the battery, W, shape (n,).
        wheel: power at the wheels, whose sign tells driving from braking, shape (n,).
        p_aux: standing load, W.
    """
    driving, braking = wheel > 0, wheel < 0
    found = np.linalg.lstsq(terms[:, driving].T, power[driving], rcond=None)[0]
    offered = -(found[:3] @ terms[:3, braking]).sum()
    mass, rolling, drag, constant = found.tolist()
    return {
        "mass_over_eta": mass,
        "regeneration": float((constant - power[braking]).sum() / offered),
        "rolling_over_eta": rolling,
        "drag_area_over_eta": drag,
        "p_aux": p_aux,
    }
