"""An experiment as JSON: W, J, s; null where unknown."""

from __future__ import annotations

from typing import Any

from evpinn_ros.extras.paper.experiment import Outcome
from evpinn_ros.extras.paper.published import LossRow
from evpinn_ros.extras.paper.scores import TableFiveRow
from evpinn_ros.extras.paper.verdict import verdict


def results_of(outcome: Outcome) -> dict[str, Any]:
    """Everything measured, in a form `json` writes."""
    settings = outcome.settings
    problem = outcome.training.problem
    return {
        "vehicle": outcome.vehicle.key,
        "settings": {
            "optimizer": settings.optimizer.value,
            "epochs": settings.epochs,
            "energy_epochs": settings.energy_epochs,
            "seed": settings.seed,
            "device": settings.device,
            "regen_form": settings.form.value,
        },
        "verdict": [
            {**finding._asdict(), "answer": finding.answer.value} for finding in verdict(outcome)
        ],
        "samples": len(outcome.log.time),
        "duration_s": float(outcome.log.time[-1]),
        "normalisation": {
            "power_middle_w": problem.scale.middle,
            "power_half_range_w": problem.scale.half_range,
            "p_aux_w": problem.p_aux,
        },
        "power_losses": {
            "random": [_loss_row(row) for row in outcome.power_rows],
            "chronological": [_loss_row(row) for row in outcome.chronological.rows],
        },
        "energy_losses": [row._asdict() for row in outcome.energy_rows],
        "parameters": {row.name: _parameter(row) for row in outcome.parameters},
        "combinations": {row.name: _parameter(row) for row in outcome.combinations},
        "least_squares_parameters": outcome.regression._asdict(),
        "scores": [
            {"method": s.method, "split": s.split, **s.score._asdict()} for s in outcome.scores
        ],
        "energy_j": {
            name: float(joules[-1]) for name, joules in outcome.energies._asdict().items()
        },
    }


def _loss_row(row: LossRow) -> dict[str, Any]:
    return {
        "epoch": row.epoch,
        "training": row.training._asdict(),
        "validation": row.validation._asdict(),
    }


def _parameter(row: TableFiveRow) -> dict[str, Any]:
    return {name: value for name, value in row._asdict().items() if name != "name"}
