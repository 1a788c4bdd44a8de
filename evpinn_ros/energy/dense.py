"""Legs as a plan of points, for a forecast that takes nothing else."""

from __future__ import annotations

import numpy as np

from evpinn_ros.energy.plan import MAX_SPEED, Legs, Plan, monotone_slopes

RAMP = 10.0  # s at the ends of a leg within which speed changes to that of the next
LONG = 4 * RAMP  # s of a leg that has such ramps; in a shorter one speed changes all the way


def dense(legs: Legs) -> Plan:
    """The plan that drives each leg at its mean speed, or at its ends as it is given there.

    What traffic adds within a leg is not in it.
    """
    end, along, height = (
        np.concatenate(([0.0], np.cumsum(each)))
        for each in (legs.duration, legs.length, legs.climb)
    )
    long = legs.duration > LONG
    time = np.sort(np.concatenate((end, end[:-1][long] + RAMP, end[1:][long] - RAMP)))
    distance, elevation = np.interp(time, end, along), np.interp(time, end, height)
    speed = np.clip(monotone_slopes(time, distance), 0.0, MAX_SPEED)
    ends = np.searchsorted(time, end)
    for at, given in ((ends[:-1], legs.start_speed), (ends[1:], legs.end_speed)):
        speed[at] = np.where(np.isnan(given), speed[at], given)
    return Plan(time, distance, speed, elevation)
