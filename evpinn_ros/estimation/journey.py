"""Sums over driving, and what one interval of it showed: small values of the posterior."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evpinn_ros.estimation.states import SIZE


class Journey(NamedTuple):
    """Sums over steps of driving, measured, unmeasured or planned; they add up.

    Attributes:
        row: energy by each state, J per unit, shape (SIZE,); of `State.LOAD` the seconds.
        seconds: s.
        noise: variance of what no state explains by its kinds, at scale 1, J^2, shape (3,).
        unseen: m of road whose height is not known.
    """

    row: np.ndarray
    seconds: float
    noise: np.ndarray
    unseen: float

    def plus(self, other: Journey) -> Journey:
        """Both, one after the other."""
        row, noise = self.row + other.row, self.noise + other.noise
        return Journey(row, self.seconds + other.seconds, noise, self.unseen + other.unseen)

    def less(self, other: Journey) -> Journey:
        """Without a part of it."""
        return self.plus(other.share(-1.0))

    def share(self, share: float) -> Journey:
        """A share of it."""
        return Journey(
            share * self.row, share * self.seconds, share * self.noise, share * self.unseen
        )


NOWHERE = Journey(np.zeros(SIZE), 0.0, np.zeros(3), 0.0)


class Learned(NamedTuple):
    """Innovation of one interval: measured less predicted, J, and its 1-sigma, J."""

    residual: float
    sigma: float
