"""Cost of a metre of this car's usual driving: the road ahead of which no plan tells.

The learned car drives its usual mix of legs of a minute, as its earlier drives had them
(`estimation.unevenness`), at the temperature and with the loads of now. So a cold morning or a
roof box counts before its kilometres are driven.
"""

from __future__ import annotations

from functools import lru_cache
import math

import numpy as np

from evpinn_ros.energy.power_model import PowerModel, Weather, even_steps
from evpinn_ros.estimation.car_model import CarModel
from evpinn_ros.estimation.unevenness import DURATIONS, MIDDLES

LEG = 60.0  # s
LEAST_METRES = 3000.0  # driven, before anything is usual


@lru_cache(maxsize=4)  # asked with every prediction, and learned every ten seconds
def usual_cost(car: CarModel) -> float:
    """Energy per distance of a car's usual mix of legs, J/m; NaN while no mix is known."""
    metres = car.unevenness.metres[:, int(np.searchsorted(DURATIONS, LEG))]
    if metres.sum() < LEAST_METRES:
        return math.nan
    legs = even_steps(np.full_like(MIDDLES, LEG), MIDDLES * LEG, 0.0 * MIDDLES)
    rows = PowerModel(car).rows(legs, Weather(car.equation.vehicle.air_density))
    rows += car.unevenness.of_legs(car.equation, legs)
    cost = float(metres @ (rows @ car.mean / legs.distance) / metres.sum())
    return cost if math.isfinite(cost) and cost > 0.0 else math.nan
