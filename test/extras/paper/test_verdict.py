"""The verdict follows what was measured: each claim is seen to hold and to fail."""

from collections.abc import Callable
from copy import copy
from dataclasses import replace

import pytest

from evpinn_ros.extras.paper.experiment import (
    CHRONOLOGICAL,
    NETWORK,
    TIME_HELD,
    Outcome,
)
from evpinn_ros.extras.paper.optimizer_name import DEFAULT_EPOCHS, OptimizerName
from evpinn_ros.extras.paper.published import POWER_LOSSES, EnergyRow, Losses, LossRow
from evpinn_ros.extras.paper.verdict import ClaimAnswer, verdict

HOLDS, PARTLY, FAILS, OPEN = ClaimAnswer
FITS, POWER, ENERGY, PARAMETERS, INTEGRATES = range(5)
ASKED = POWER_LOSSES["tesla_model_3_lr"][-1].validation.total


@pytest.fixture(scope="module")
def outcome(reproduced: Callable[[OptimizerName], Outcome]) -> Outcome:
    return reproduced(OptimizerName.GAUSS_NEWTON)


def trained_to(outcome: Outcome, total: float, epochs: int) -> Outcome:
    """An outcome with another loss at the end."""
    training = copy(outcome.training)
    losses = Losses(total, total, 0.0)
    training.rows = [*training.rows, LossRow(epochs, losses, losses)]
    settings = replace(outcome.settings, epochs=epochs)
    return replace(outcome, training=training, settings=settings)


def scored(outcome: Outcome, method: str = NETWORK, **score: float | None) -> Outcome:
    """An outcome with another score of a method on road not yet driven."""
    rows = [
        method_score._replace(score=method_score.score._replace(**score))
        if (method_score.method, method_score.split) == (method, CHRONOLOGICAL)
        else method_score
        for method_score in outcome.scores
    ]
    return replace(outcome, scores=rows)


@pytest.mark.parametrize(
    ("share", "epochs", "answer"),
    [(0.9, 30, HOLDS), (1.1, 30, OPEN), (1.1, DEFAULT_EPOCHS[OptimizerName.GAUSS_NEWTON], FAILS)],
)
def test_the_loss_is_compared_with_the_papers(
    outcome: Outcome, share: float, epochs: int, answer: ClaimAnswer
) -> None:
    """A training cut short that is not there yet has not failed."""
    finding = verdict(trained_to(outcome, share * ASKED, epochs))[FITS]
    assert finding.answer is answer
    assert f"{share * ASKED:.4f}" in finding.measured and f"{ASKED:.4f}" in finding.measured
    assert "not the paper's adam" in finding.measured


@pytest.mark.parametrize(
    ("r2", "answer"), [(0.95, HOLDS), (0.5, FAILS), (-0.06, FAILS), (-370.0, FAILS), (None, OPEN)]
)
def test_power_of_road_not_yet_driven(
    outcome: Outcome, r2: float | None, answer: ClaimAnswer
) -> None:
    """Time as an input is named as the cause where holding it makes the difference."""
    finding = verdict(scored(scored(outcome, r2=r2), TIME_HELD, r2=-0.05))[POWER]
    assert finding.answer is answer
    assert ("Time is one of its inputs" in finding.measured) is (r2 == -370.0)


@pytest.mark.parametrize(
    ("off", "answer"), [(4.9, HOLDS), (-4.9, HOLDS), (-93.0, FAILS), (None, OPEN)]
)
def test_energy_of_road_not_yet_driven(
    outcome: Outcome, off: float | None, answer: ClaimAnswer
) -> None:
    assert verdict(scored(outcome, energy_error_percent=off))[ENERGY].answer is answer


def test_parameters_that_the_data_determine(outcome: Outcome) -> None:
    """mass/eta of stop and go is known, mass alone never; with nothing known the claim fails."""
    finding = verdict(outcome)[PARAMETERS]
    assert finding.answer is PARTLY
    known, _, guessed = finding.measured.partition("; not determined: ")
    assert "mass/eta" in known and {"eta", "mass", "C_d"} <= set(guessed.split(".")[0].split(", "))
    assert "Table V" in guessed

    def all_are(determined: bool) -> Outcome:
        rows = ([r._replace(determined=determined) for r in outcome.combinations],)
        rows += ([r._replace(determined=determined) for r in outcome.parameters],)
        return replace(outcome, combinations=rows[0], parameters=rows[1])

    assert verdict(all_are(True))[PARAMETERS].answer is HOLDS
    assert verdict(all_are(False))[PARAMETERS].answer is FAILS


@pytest.mark.parametrize(
    ("rknn", "last", "answer"), [(0.4, 100, HOLDS), (0.9, 100, OPEN), (0.9, 10_000, FAILS)]
)
def test_energy_networks_are_compared_by_the_median(
    outcome: Outcome, rknn: float, last: int, answer: ClaimAnswer
) -> None:
    """One lucky epoch, or the first tenth of them, decides nothing."""
    rows = [EnergyRow(last * i // 100, 0.0, rknn, 0.0, 1.0) for i in range(1, 101)]
    rows[:10] = [row._replace(rknn_validation=9.0 if rknn < 0.5 else 0.0) for row in rows[:10]]
    rows[-1] = rows[-1]._replace(rknn_validation=1e-9, dnn_validation=1e9)
    assert verdict(replace(outcome, energy_rows=rows))[INTEGRATES].answer is answer
