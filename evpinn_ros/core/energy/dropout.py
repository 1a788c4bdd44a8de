"""A battery dropout: its prediction, and the reconciliation when it is over.

The states of charge before and after also give the energy of a dropout, with the uncertainty of
their steps and of the capacity. Both energies are averaged by their variances. If the state of
charge rose, the car was charged; if the energies are more than three sigma apart, they contradict
each other. In both cases the prediction stays, and the diagnostics say so. If speed was silent
too, the prediction lacks that time: the state of charge counts alone, if its sigma is smaller
(`energy.hole`). Without a state of charge nothing shows the error of the prediction.
"""

from __future__ import annotations

from enum import Enum
import math
from typing import NamedTuple

from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.plausible import Joules, Seconds

LEAST_DROPOUT = 60.0  # s; in less, the state of charge moves by hardly a step
MOST_UNKNOWN = 2.0  # s without speed that a prediction may lack
CONTRADICTION = 3.0  # sigma


class Bridge(NamedTuple):
    """Prediction for a dropout, or for many.

    Attributes:
        energy: net, J.
        regenerated: as positive J.
        gross: drawn and regenerated together, J.
        covered_s: time that the prediction covers, s.
    """

    energy: Joules = 0.0
    regenerated: Joules = 0.0
    gross: Joules = 0.0
    covered_s: Seconds = 0.0


class Dropout(NamedTuple):
    """One battery dropout that ended.

    Attributes:
        end_ns: stamp of the first battery reading after it.
        duration: s.
        bridge: its prediction.
        sigma: 1-sigma of its energy, unknown time included, J.
    """

    end_ns: int
    duration: float
    bridge: Bridge
    sigma: float

    @property
    def unknown_s(self) -> float:
        """Time in it without speed, s."""
        return max(self.duration - self.bridge.covered_s, 0.0)


class Verdict(str, Enum):
    """Verdict on a dropout."""

    PREDICTED = "predicted: no state of charge to compare"
    SHORT = "predicted: too short for the state of charge to tell"
    JOINED = "joined with the state of charge"
    CHARGE_ALONE = "from the state of charge: speed was silent too"
    CHARGED = "charged in between: the prediction stays"
    CONTRADICTED = "the state of charge contradicts the prediction, which stays"


class Reconciled(NamedTuple):
    """A dropout and its reconciliation; energies in J.

    Attributes:
        dropout: with its prediction.
        by_charge: energy by the state of charge, NaN if unknown.
        correction: added to the prediction.
        variance_taken: decrease of the variance of the energy, J^2; negative if it rose.
        verdict: rule that applied.
    """

    dropout: Dropout
    by_charge: Uncertain
    correction: float
    variance_taken: float
    verdict: Verdict


def reconcile(dropout: Dropout, by_charge: Uncertain) -> Reconciled:
    """Reconcile the prediction of a dropout with the energy by the state of charge, J."""

    def keep(verdict: Verdict) -> Reconciled:
        return Reconciled(dropout, by_charge, 0.0, 0.0, verdict)

    difference = by_charge.value - dropout.bridge.energy
    if not (math.isfinite(difference) and math.isfinite(dropout.sigma)):
        return keep(Verdict.PREDICTED)
    if dropout.duration < LEAST_DROPOUT:
        return keep(Verdict.SHORT)
    both = math.hypot(dropout.sigma, by_charge.sigma)
    if difference < -CONTRADICTION * both and by_charge.value < 0:
        return keep(Verdict.CHARGED)
    if dropout.unknown_s > MOST_UNKNOWN and by_charge.sigma < dropout.sigma:
        taken = dropout.sigma**2 - by_charge.sigma**2
        return Reconciled(dropout, by_charge, difference, taken, Verdict.CHARGE_ALONE)
    if abs(difference) > CONTRADICTION * both:
        return keep(Verdict.CONTRADICTED)
    gain = (dropout.sigma / both) ** 2
    taken = gain * dropout.sigma**2
    return Reconciled(dropout, by_charge, gain * difference, taken, Verdict.JOINED)
