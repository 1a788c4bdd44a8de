"""A battery dropout, seen again when it is over.

The energy of a dropout was predicted. The state of charge before and after says it too, as sure as
its steps and the capacity are: two statements of one quantity, joined by their variances. What
cannot be: a state of charge that rose was charged in between, and two statements further apart
than three sigma contradict each other; then the prediction stays, and the diagnostics say so.
Where speed was silent as well the prediction lacks that time: the state of charge alone counts.
Without a state of charge nothing is known of how wrong the prediction was: the battery tells
power, and the power of that time is gone.
"""

from __future__ import annotations

from enum import Enum
import math
from typing import NamedTuple

from evpinn_ros.energy.charge import Uncertain
from evpinn_ros.energy.dropout import Dropout

LEAST_DROPOUT = 60.0  # s; in less the state of charge hardly moves a step
MOST_UNKNOWN = 2.0  # s without speed that a prediction may lack
CONTRADICTION = 3.0  # sigma


class Verdict(str, Enum):
    """Verdict on a dropout."""

    PREDICTED = "predicted: no state of charge to compare"
    SHORT = "predicted: too short for the state of charge to tell"
    JOINED = "joined with the state of charge"
    CHARGE_ALONE = "from the state of charge: speed was silent too"
    CHARGED = "charged in between: the prediction stays"
    CONTRADICTED = "the state of charge contradicts the prediction, which stays"


class Reconciled(NamedTuple):
    """A dropout and what was made of it; energies in J.

    Attributes:
        dropout: with what was predicted.
        by_charge: the energy that the state of charge says, NaN where it says nothing.
        correction: added to what was predicted.
        variance_taken: by which the variance of the energy fell, J^2; negative where it rose.
        verdict: which of the rules applied.
    """

    dropout: Dropout
    by_charge: Uncertain
    correction: float
    variance_taken: float
    verdict: Verdict


def reconcile(dropout: Dropout, by_charge: Uncertain) -> Reconciled:
    """Join the prediction of a dropout with the energy, J, that the state of charge says."""

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
    if dropout.unknown_s > MOST_UNKNOWN:
        taken = dropout.sigma**2 - by_charge.sigma**2
        return Reconciled(dropout, by_charge, difference, taken, Verdict.CHARGE_ALONE)
    if abs(difference) > CONTRADICTION * both:
        return keep(Verdict.CONTRADICTED)
    gain = (dropout.sigma / both) ** 2
    taken = gain * dropout.sigma**2
    return Reconciled(dropout, by_charge, gain * difference, taken, Verdict.JOINED)
