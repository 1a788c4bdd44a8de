"""Truth of a car of another simulator, from its trace without noise.

It is computed as for our own simulated cars (`simulation.truth.combinations`), over steps of
`TRUTH_STEP`; p_aux is the power of the standing car. The parameters in the simulator's file
divided by a mean eta are not this truth: losses without torque act as a force, which the battery
cannot distinguish from that of the tyres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evpinn_ros.core.estimation.terms import Equation
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.replays.simulation.truth import TRUTH_STEP, combinations


class Moved(NamedTuple):
    """Steps of a trace, shape (n,)."""

    duration: np.ndarray  # s
    distance: np.ndarray  # m
    air: np.ndarray  # integral of v^3, m^3/s^2
    kinetic: np.ndarray  # difference of v^2 / 2, J/kg
    climb: np.ndarray  # difference of height, m

    @classmethod
    def between(
        cls, before: np.ndarray, after: np.ndarray, seconds: np.ndarray, climb: np.ndarray
    ) -> Moved:
        """Steps of even acceleration from one speed to another, m/s."""
        return cls(
            duration=seconds,
            distance=(before + after) / 2.0 * seconds,
            air=(before + after) * (before**2 + after**2) / 4.0 * seconds,
            kinetic=(after**2 - before**2) / 2.0,
            climb=climb,
        )


def noise_free_truth(
    moved: Moved, energy: np.ndarray, p_aux: float, vehicle: Vehicle, air_density: float
) -> dict[str, float]:
    """The combinations by `method.NAMES`.

    Args:
        moved: steps of one length, one after the other.
        energy: of the battery in each, J, shape (n,).
        p_aux: standing load, W.
        vehicle: by whose car steps are driving or braking.
        air_density: kg/m^3.
    """
    count = max(1, round(TRUTH_STEP / float(np.median(moved.duration))))
    whole = len(energy) // count * count
    columns = (*moved, energy - p_aux * moved.duration)
    sums = (column[:whole].reshape(-1, count).sum(1) for column in columns)
    *steps, moving = sums
    whole_steps, equation = Moved(*steps), Equation(vehicle)
    wheels = equation.wheels(**whole_steps._asdict(), density=air_density)
    values = combinations(equation, wheels, whole_steps.duration, moving)
    return values | {"p_aux": p_aux}
