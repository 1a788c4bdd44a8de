"""Legs as a plan of points, for a forecast that takes nothing else."""

from __future__ import annotations

import numpy as np

from evpinn_ros.energy.plan import MAX_SPEED, Legs, Plan, monotone_slopes


def dense(legs: Legs) -> Plan:
    """The plan that drives each leg in its duration, its speeds changing as little as may be.

    Speed at the ends of legs is the slope of a monotone cubic, or as it is given there. What
    traffic adds between them is not in it.
    """
    time, distance, elevation = (
        np.concatenate(([0.0], np.cumsum(each)))
        for each in (legs.duration, legs.length, legs.climb)
    )
    speed = np.clip(monotone_slopes(time, distance), 0.0, MAX_SPEED)
    for part, given in ((speed[:-1], legs.start_speed), (speed[1:], legs.end_speed)):
        np.copyto(part, given, where=~np.isnan(given))
    return Plan(time, distance, speed, elevation)
