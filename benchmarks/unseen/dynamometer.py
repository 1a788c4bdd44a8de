"""Truth of a recorded car from the dynamometer that its makers or testers set.

Its mass is the inertia that was set, and its road load the force that was set, nearest to which
C_rr m g + rho/2 C_d A v^2 comes over the way of standard driving. No dynamometer measures
the efficiency: `ETA`, of the inverter, motor and gears of an electric car, is the base of the
combinations (m/eta of these drives by another method: 2075 +- 30 kg).
"""

from __future__ import annotations

import numpy as np

from evpinn_ros.estimation.network import reference_driving
from evpinn_ros.vehicle.physics import GRAVITY

ETA = 0.92
DENSITY = 1.2  # kg/m^3 that drag is told at
KMH = 3.6


def dynamometer_truth(mass: float, force: tuple[float, float, float]) -> dict[str, float]:
    """Combinations by `method.NAMES` but for braking and standing load.

    Args:
        mass: set, kg.
        force: set, N by powers of speed in km/h.
    """
    driving = reference_driving()
    speed, weight = driving.speed, np.sqrt(driving.seconds * driving.speed)
    wanted = np.polynomial.polynomial.polyval(speed * KMH, force)
    terms = np.stack((np.full_like(speed, GRAVITY), DENSITY / 2.0 * speed**2), axis=1)
    found = np.linalg.lstsq(weight[:, None] * terms, weight * wanted, rcond=None)[0]
    rolling, area = (found / ETA).tolist()
    return {
        "mass_over_eta": mass / ETA,
        "rolling_over_eta": rolling,
        "drag_area_over_eta": area,
    }


# Electric sedan of Jilin University (Yuan et al., Patterns 2024), as its data set tells.
CHANGCHUN = dynamometer_truth(1919.0, (179.4, 0.28, 0.0235))
