"""Battery power of one car as numbers that add up: what an estimator gives and a forecast takes.

Power at a moment is a sum of features of the moment, each times a coefficient, and what is not
known of the coefficients is a sum of independent directions, each of one sigma. So energy along a
trip is one product with the integrals of the features, and its variance the sum of the squares of
the products with the directions: an error of a coefficient is wrong in the same sense for the
whole trip.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

# With drag (air_density v^3 / 2, per m^2), rolling (g v cos(grade), per kg of mass times c_rr) and
# force (v (g sin(grade) + factor a), per kg): apart for a car that drives and one that brakes,
# whose recuperation fades at a walking pace (`FADE_SPEED`).
FADE_SPEED = 3.5  # m/s, below it recuperation fades, none is left at `FADE_END`
FADE_END = 0.5  # m/s
CREEPING = 0.3  # m/s, slower the drivetrain stands
TURNING_SPEED = 10.0  # m/s, at which the loss by turning is a power of that size
MOST_FORCE = 4.0  # m/s^2 of force over mass, more is no tyre's
FEATURES = (
    "drive_drag",
    "drive_rolling",
    "drive_force",
    "brake_drag",
    "brake_rolling",
    "brake_force",
    "constant",
    "turning",  # of the drivetrain, see `turning`
    "force_squared",  # (force at the wheels over mass)^2 while it turns
    "present_drift",  # exp(-t / drift_time): what is left of the present drift of auxiliary power
)


def turning(speed: Any) -> Any:
    """Loss of a drivetrain that turns, over that at `TURNING_SPEED`; elementwise, any library.

    Half of it is drawn as soon as it turns (control of the inverter, iron), half grows with speed
    (bearings, oil).
    """
    return (speed > CREEPING) * (0.5 + 0.5 * speed / TURNING_SPEED)


@dataclass(frozen=True, slots=True, eq=False)
class LinearPower:
    """A car; see the module's text."""

    # m^2; with the next two it tells driving from braking, by the sign of the power at the wheels
    drag_area: float
    rolling_mass: float  # mass times c_rr, kg
    mass: float  # kg
    rotating_mass_factor: float  # effective over static mass when accelerating
    standing_noise: float  # 1-sigma of the power around the model at standstill, W
    moving_noise: float  # likewise while moving, over speed, N; both together as squares
    drift_std: float  # W, 1-sigma of the auxiliary power around its mean
    drift_time: float  # s within which that forgets itself
    slope_force: float  # N at the battery, 1-sigma of unknown slopes and wind
    slope_length: float  # m within which these change
    mean: np.ndarray  # coefficients, shape (len(FEATURES),), W per unit of the feature
    directions: np.ndarray  # of what is not known of them, shape (k, len(FEATURES))
