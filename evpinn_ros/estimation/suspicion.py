"""Signals that contradict each other, named so that a person can mend them."""

from __future__ import annotations

import math

from evpinn_ros.signals.sample import Sample

CURRENT_SIGN = "current_sign"
MEMORY = 60.0  # s of pulling away and braking that the verdict rests on
ENOUGH = 10.0  # s of them before there is a verdict
HARD = 0.5  # m/s^2: from here on inertia outweighs road load and auxiliaries
SUSPECT_BELOW, CLEAR_ABOVE = -0.5, 0.0  # of the share of power that goes with inertia, -1..1
MOVING = 2.0  # m/s


class SignSuspicion:
    """Whether current has the wrong sign: to accelerate costs power, in every car.

    Followed is the sum of power signed by acceleration over the sum of its size, wherever the car
    pulls away or brakes with more than `HARD`: about +0.9 as it should be, -0.9 with the sign
    flipped.
    """

    def __init__(self) -> None:
        """Nothing seen, nothing suspected."""
        self.suspected = False
        self._with = self._size = self._seconds = 0.0

    def push(self, sample: Sample, power: float, step: float) -> None:
        """Learn from measured power, W, that stands for `step` seconds."""
        if abs(sample.acceleration) < HARD or sample.speed < MOVING:
            return
        keep = math.exp(-step / MEMORY)
        self._with = keep * self._with + math.copysign(power, power * sample.acceleration) * step
        self._size = keep * self._size + abs(power) * step
        self._seconds = keep * self._seconds + step
        if self._seconds < ENOUGH or self._size <= 0.0:
            return
        share = self._with / self._size
        self.suspected = share < (CLEAR_ABOVE if self.suspected else SUSPECT_BELOW)
