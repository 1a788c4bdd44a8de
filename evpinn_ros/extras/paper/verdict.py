"""The paper's claims on one drive: five findings, each from measurements of the drive."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from evpinn_ros.extras.paper.experiment import (
    BASELINES,
    CHRONOLOGICAL,
    NETWORK,
    RANDOM,
    REGRESSION,
    TIME_HELD,
    WHOLE,
    Outcome,
)
from evpinn_ros.extras.paper.published import ENERGY_LOSSES, POWER_LOSSES
from evpinn_ros.extras.paper.scores import PowerScore
from evpinn_ros.extras.paper.settings import DEFAULT_EPOCHS, OptimizerName
from evpinn_ros.extras.paper.tables import r2_text

GOOD_R2 = 0.9  # of power, from which on it counts as predicted
GOOD_ENERGY = 5.0  # percent error of energy, up to which it counts as predicted
BETTER = 0.5  # of the plain network's loss, up to which the other is better; paper: 0.38
EXPLAINING = 0.1  # gain of R\u00b2 with time held, which explains a bad R\u00b2
NAMES = {
    "c_rr": "C_rr",
    "c_d": "C_d",
    "mass_over_eta": "mass/eta",
    "drag_area_over_eta": "A C_d/eta",
    "regeneration": "eta mu",
}
CRITERIA = (
    "The claims hold if, in this order: the validation loss is at most the paper's; R\u00b2 of "
    f"power is at least {GOOD_R2:g}; energy is within {GOOD_ENERGY:g} %; the data determine all "
    f"five parameters; the loss is at most {BETTER:g} times the plain network's (medians over the "
    "last nine tenths of the epochs)."
)


class ClaimAnswer(str, Enum):
    """Answer of a drive to a claim."""

    HOLDS = "holds"
    PARTLY = "holds in part"
    FAILS = "does not hold"
    OPEN = "left open"


class Finding(NamedTuple):
    """One claim of the paper."""

    claim: str  # of the paper
    answer: ClaimAnswer  # of this drive
    measured: str  # the measurement behind the answer

    def __str__(self) -> str:
        return f"{self.answer.value.upper()}. {self.claim}: {self.measured}."


def verdict(outcome: Outcome) -> list[Finding]:
    """Findings on the five claims in the order of the paper's abstract, Table IV last."""
    return [_fits(outcome), *_predicts(outcome), _parameters(outcome), _integrates(outcome)]


def _fits(outcome: Outcome) -> Finding:
    settings, rows = outcome.settings, POWER_LOSSES.get(outcome.vehicle.key)
    published = [rows] if rows else POWER_LOSSES.values()
    asked = max(losses[-1].validation.total for losses in published)
    reached = outcome.training.rows[-1].validation.total
    if reached <= asked:
        answer = ClaimAnswer.HOLDS
    elif settings.epochs < DEFAULT_EPOCHS[settings.optimizer]:
        answer = ClaimAnswer.OPEN
    else:
        answer = ClaimAnswer.FAILS
    other = "" if settings.optimizer is OptimizerName.ADAM else " (the paper used adam)"
    line = _score(outcome, BASELINES[RANDOM], RANDOM).data_loss
    return Finding(
        "The network learns the power of a drive",
        answer,
        f"validation loss {_loss(reached)} after {settings.epochs} epochs of "
        f"{settings.optimizer.value}{other}; in the paper {_loss(asked)}; linear interpolation "
        f"between neighbouring samples has {_loss(line)}",
    )


def _predicts(outcome: Outcome) -> tuple[Finding, Finding]:
    """Findings on power and energy of the last fifth of the drive, outside the training."""
    network = _score(outcome, NETWORK, CHRONOLOGICAL)
    physics = _score(outcome, REGRESSION, CHRONOLOGICAL)
    power = energy = ClaimAnswer.OPEN
    if network.r2 is not None:
        power = ClaimAnswer.HOLDS if network.r2 >= GOOD_R2 else ClaimAnswer.FAILS
    if network.energy_error_percent is not None:
        good = abs(network.energy_error_percent) <= GOOD_ENERGY
        energy = ClaimAnswer.HOLDS if good else ClaimAnswer.FAILS
    held = _score(outcome, TIME_HELD, CHRONOLOGICAL)
    why = ""
    if network.r2 is not None and held.r2 is not None and held.r2 - network.r2 > EXPLAINING:
        why = (
            ". Time is an input of the network, and the last fifth lies outside the trained "
            f"range; with time held at the end of that range, R\u00b2 is {r2_text(held.r2)}"
        )
    return (
        Finding(
            "The network predicts power outside the training",
            power,
            f"R\u00b2 {r2_text(network.r2)} on the last fifth of the drive; eq. 21 alone, fitted, "
            f"has {r2_text(physics.r2)}, the mean 0{why}",
        ),
        Finding(
            "The network predicts energy outside the training",
            energy,
            f"error {_off(network)} on the last fifth of the drive; that of eq. 21 alone is "
            f"{_off(physics)}",
        ),
    )


def _parameters(outcome: Outcome) -> Finding:
    determined = [row.name for row in outcome.combinations if row.determined]
    guessed = [row.name for row in outcome.parameters if not row.determined]
    answer = (
        (ClaimAnswer.PARTLY if determined else ClaimAnswer.FAILS) if guessed else ClaimAnswer.HOLDS
    )
    measured = f"the data determine {_named(determined)}"
    if guessed:
        measured += f"; they do not determine {_named(guessed)}"
    table_five = f"Table V, {outcome.settings.form.value}"
    if any(score.method == table_five for score in outcome.scores):
        off = _off(_score(outcome, table_five, WHOLE))
        measured += f". With the values of Table V, the energy error of this drive is {off}"
    return Finding("Speed and power determine the parameters of the car", answer, measured)


def _integrates(outcome: Outcome) -> Finding:
    last = outcome.energy_rows[-1].epoch
    late = [row for row in outcome.energy_rows if row.epoch > last / 10]
    rknn = float(np.median([row.rknn_validation for row in late]))
    plain = float(np.median([row.dnn_validation for row in late]))
    paper = ENERGY_LOSSES[-1]
    if rknn <= BETTER * plain:
        answer = ClaimAnswer.HOLDS
    else:
        answer = ClaimAnswer.OPEN if last < paper.epoch else ClaimAnswer.FAILS
    return Finding(
        "Runge-Kutta improves the energy network",
        answer,
        f"validation loss {_loss(rknn)} with it and {_loss(plain)} without, in {last} epochs; in "
        f"the paper {_loss(paper.rknn_validation)} and {_loss(paper.dnn_validation)} in "
        f"{paper.epoch}. Integrating the power exactly needs no network",
    )


def _score(outcome: Outcome, method: str, split: str) -> PowerScore:
    return next(s.score for s in outcome.scores if (s.method, s.split) == (method, split))


def _loss(value: float) -> str:
    return np.format_float_positional(value, 2, fractional=False, trim="-")


def _off(score: PowerScore) -> str:
    off = score.energy_error_percent
    return "unknown" if off is None else f"{off:+.1f} %"


def _named(names: Sequence[str]) -> str:
    return ", ".join(NAMES.get(name, name) for name in names) or "nothing"
