"""Longitudinal dynamics and battery power of an electric car: eq. 11 to 21 of the EV-PINN paper.

Every function works elementwise on floats, numpy arrays and torch tensors alike. Angles are in
radians, positive uphill; power is positive when drawn from the battery. All else is SI.

The paper's eq. 19-21 join the forces of eq. 12-15 to battery power in three readings
(`RegenForm`), because eq. 21 as printed contradicts the parameters of its own Table V.
"""

from __future__ import annotations

from enum import Enum
from typing import Any

import numpy as np

from evpinn_ros.core.vehicle.parameters import Parameters

GRAVITY = 9.80665  # m/s^2, ISO 80000-3
STANDSTILL_SPEED = 0.1  # m/s: below this a car stands and draws auxiliary power only


class RegenForm(str, Enum):
    """Effect of braking on battery power. See `battery_power`."""

    PRINTED = "printed"
    RECOVERY = "recovery"
    WHEEL_POWER = "wheel_power"


def _sin(x: Any) -> Any:
    return x.sin() if hasattr(x, "sin") else np.sin(x)


def _cos(x: Any) -> Any:
    return x.cos() if hasattr(x, "cos") else np.cos(x)


def drag_force(speed: Any, drag_area: Any, air_density: Any) -> Any:
    """Aerodynamic drag (eq. 12), N, against the motion; drag_area = A * C_d, m^2."""
    return 0.5 * air_density * drag_area * speed * abs(speed)


def rolling_force(mass: Any, c_rr: Any, grade: Any = 0.0) -> Any:
    """Rolling resistance of a moving car (eq. 13), N, against the motion."""
    return c_rr * mass * GRAVITY * _cos(grade)


def grade_force(mass: Any, grade: Any) -> Any:
    """Component of weight along the road (eq. 14), N, positive uphill."""
    return mass * GRAVITY * _sin(grade)


def inertia_force(mass: Any, acceleration: Any) -> Any:
    """Force that accelerates the car (eq. 15), N."""
    return mass * acceleration


def motor_force(battery_power: Any, auxiliary_power: Any, eta: Any, speed: Any) -> Any:
    """Force of the motor at the wheels (eq. 16), N; the speed must not be zero."""
    return eta * (battery_power - auxiliary_power) / speed


def regeneration_indicator(acceleration: Any, beta: float) -> Any:
    """I of eq. 21: 1.0 where the car brakes harder than the threshold beta (m/s^2), else 0.0."""
    return (acceleration < beta) * 1.0


def road_load_power(
    speed: Any, parameters: Parameters, area: float, air_density: Any, grade: Any = 0.0
) -> Any:
    """Power against drag, rolling resistance and grade at the wheels (eq. 12-14), W."""
    force = drag_force(speed, area * parameters.c_d, air_density)
    force = force + grade_force(parameters.mass, grade)
    rolling = rolling_force(parameters.mass, parameters.c_rr, grade)
    return speed * force + abs(speed) * rolling


def battery_power(
    speed: Any,
    acceleration: Any,
    parameters: Parameters,
    *,
    area: float,
    air_density: Any,
    form: RegenForm,
    beta: float,
    grade: Any = 0.0,
) -> Any:
    """Battery power of the complete dynamics, W: eq. 17-21, with grade.

    With road load R = v (drag + rolling + grade), inertia K = m v a and the indicator I:

    - `printed`: P = [R + K (1 - mu I)] / eta + P_aux, eq. 21 to the letter. Larger mu recovers
      less, so the name and the role of mu are inverted.
    - `recovery`: P = [R + K (mu I + 1 - I)] / eta + P_aux, what Table V's values imply.
    - `wheel_power`: with W = R + K, P = W / eta + P_aux where W > 0 and mu W + P_aux elsewhere.
      The only form that is continuous and cannot create energy.
    """
    load = road_load_power(speed, parameters, area, air_density, grade)
    kinetic = inertia_force(parameters.mass, acceleration) * speed
    if form is RegenForm.WHEEL_POWER:
        wheel = load + kinetic
        driving = wheel * (wheel > 0)
        traction = driving / parameters.eta + (wheel - driving) * parameters.mu
        return traction + parameters.p_aux
    braking = kinetic * regeneration_indicator(acceleration, beta)
    if form is RegenForm.PRINTED:
        kinetic = kinetic - parameters.mu * braking
    else:
        kinetic = kinetic - (1.0 - parameters.mu) * braking
    return (load + kinetic) / parameters.eta + parameters.p_aux


def auxiliary_power(speed: np.ndarray, power: np.ndarray) -> float:
    """P_aux as the paper finds it: median battery power, W, while the car stands (section III.C).

    Speed, m/s, and power have shape (n,).

    Returns:
        The median, or NaN when the car never stood.
    """
    standing = power[np.abs(speed) < STANDSTILL_SPEED]
    return float(np.median(standing)) if standing.size else float("nan")
