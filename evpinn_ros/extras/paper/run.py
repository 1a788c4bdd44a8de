"""The work of `evpinn reproduce`: the paper's experiment on a recorded drive."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
import time
from typing import Any

import numpy as np
import torch

from evpinn_ros.cli.console import (
    Report,
    command_line,
    note,
    progress_bar,
    results,
    say,
    show,
    write_json,
)
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.common.saved_fields import plain
from evpinn_ros.core.estimation.estimator import EstimatorSettings, Mode, OnlineEstimator
from evpinn_ros.core.estimation.state_file import write_state
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.vehicle.files import load_vehicle, write_vehicle
from evpinn_ros.core.vehicle.parameters import LIMITS, PARAMETER_NAMES, Parameters, Prior
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.extras.paper.drive_log import ReadLog, read_drive_log
from evpinn_ros.extras.paper.experiment import TRAININGS, Experiment, OnProgress, Outcome
from evpinn_ros.extras.paper.learner import POWER_SCALE, SPEED_SCALE, WINDOW, SavedPaper
from evpinn_ros.extras.paper.log_parameters import LEARNED
from evpinn_ros.extras.paper.network import PowerNetwork
from evpinn_ros.extras.paper.page import write_reproduction
from evpinn_ros.extras.paper.problem import Problem
from evpinn_ros.extras.paper.published import LossRow
from evpinn_ros.extras.paper.scores import TableFiveRow
from evpinn_ros.extras.paper.settings import (
    ENERGY_EPOCHS,
    PUBLISHED_EPOCHS,
    OptimizerName,
    Settings,
)
from evpinn_ros.extras.paper.tables import ResultTable, all_tables
from evpinn_ros.extras.paper.verdict import CRITERIA, verdict
from evpinn_ros.logs.read_options import ReadOptions

LEAST_RELATIVE_STD = 0.005  # of a written prior: every car changes from day to day


@torch.no_grad()
def window_network(problem: Problem, network: PowerNetwork) -> PowerNetwork:
    """The same network in the units of `extras.paper.learner`, float32; scalings are affine."""
    copied = deepcopy(network).cpu().double()
    first, last = copied.layers[0], copied.layers[-1]
    end = float(problem.log.time[-1])
    middle, half_range = torch.tensor(problem.inputs, dtype=torch.float64).T
    at_now = torch.tensor([0.0, end], dtype=torch.float64)
    first.bias.add_(first.weight @ ((at_now - middle) / half_range))
    first.weight.mul_(torch.tensor([SPEED_SCALE, WINDOW], dtype=torch.float64) / half_range)
    last.weight.mul_(problem.scale.half_range / POWER_SCALE)
    last.bias.copy_((problem.scale.middle + problem.scale.half_range * last.bias) / POWER_SCALE)
    return copied.float()


def write_estimator_state(path: Path, outcome: Outcome) -> None:
    """Write a `mode: paper` state for `evpinn replay --state` and the node.

    Raises OSError, or ValueError if the estimator would refuse the state.
    """
    settings = EstimatorSettings(mode=Mode.PAPER, regen_form=outcome.settings.form)
    estimator = OnlineEstimator(outcome.vehicle, settings, InlineWorker(lambda: 0.0))
    problem, training = outcome.training.problem, outcome.training
    residual = outcome.predicted_power - outcome.log.power
    learner = SavedPaper(
        network=window_network(problem, training.network).vector().detach().numpy(),
        log_scale=training.log_scale.detach().cpu().numpy(),
        p_aux=problem.p_aux,
        covariance=outcome.covariance,
        variance=float(np.mean(residual**2)),
        fresh=False,
        regen_form=outcome.settings.form.value,
    )
    state = plain(replace(estimator.saved(), learner=learner))
    estimator.restore(state)
    write_state(path, state)


def write_vehicle_file(path: Path, outcome: Outcome, log_name: str) -> None:
    """Write the vehicle with the learned parameters as its priors, and read it back.

    Its mu is that of the form `wheel_power`, fitted to the same samples. Raises OSError or
    InputError.
    """
    vehicle = outcome.vehicle
    source = f"evpinn reproduce {log_name}, from vehicle file {vehicle.key}"
    problem = Problem(
        outcome.log, vehicle, outcome.training.problem.split, form=RegenForm.WHEEL_POWER
    )
    fit = problem.fit(problem.training, problem.training.power)
    fitted = outcome.training.values._replace(mu=problem.values(fit.log_scale).mu)
    values = possible(fitted, outcome.settings.form)
    variance = np.diag(outcome.covariance).copy()
    variance[LEARNED.index("mu")] = np.diag(fit.covariance)[LEARNED.index("mu")]
    relative = dict(zip(LEARNED, np.sqrt(variance).tolist(), strict=True))
    priors = {
        name: Prior(
            float(getattr(values, name)),
            float(getattr(values, name)) * max(relative[name], LEAST_RELATIVE_STD)
            if name in relative
            else vehicle.priors[name].std,
            source,
        )
        for name in PARAMETER_NAMES
    }
    write_vehicle(path, replace(vehicle, priors=priors))


def possible(values: Parameters, form: RegenForm) -> Parameters:
    """The nearest possible parameters: eta <= 1 and all within their limits.

    Scaling eta, mass and C_d together does not change power; in `wheel_power` mu scales inversely.
    """
    excess = max(1.0, values.eta / LIMITS["eta"].upper)
    slid = values._replace(
        eta=values.eta / excess,
        mu=values.mu * (excess if form is RegenForm.WHEEL_POWER else 1.0),
        mass=values.mass / excess,
        c_d=values.c_d / excess,
    )
    return Parameters(
        *(float(np.clip(getattr(slid, name), *LIMITS[name])) for name in PARAMETER_NAMES)
    )


FILE_WIDTH = 100  # characters of a table in a file


def run_reproduction(
    log: Path,
    vehicle: str,
    settings: Settings,
    out: Path | None,
    options: ReadOptions,
    *,
    quick: bool,
) -> None:
    """Train, print, and write report, results, state and vehicle file.

    Raises:
        InputError: the log, the vehicle or the device is wrong, or a file cannot be written.
    """
    if settings.device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: torch finds no CUDA device here")
    # One thread: small matrices gain nothing from two, and runs repeat bit by bit.
    limit_blas_threads()
    car = load_vehicle(vehicle)
    read = read_drive_log(log, car, options)
    folder = out or Path("out") / "reproduce" / log.stem
    with as_input_error(f"{folder}: cannot be written"):
        folder.mkdir(parents=True, exist_ok=True)
    note(_what_was_read(read))
    label = _label(settings, quick)
    begin = time.perf_counter()
    with training_progress() as on_progress:
        outcome = Experiment(read.drive, car, settings, folder).run(on_progress)
    note(f"trained and scored in {time.perf_counter() - begin:.0f} s")
    say(label)
    say()
    for finding in verdict(outcome):
        say(str(finding))
    say(CRITERIA, style="dim")
    say()
    for table in all_tables(outcome):
        _print(table)
    _write(outcome, read, folder, log, label)


def _what_was_read(read: ReadLog) -> str:
    dropped = ", ".join(f"{count} {reason}" for reason, count in read.dropped.items())
    return (
        f"{len(read.drive.time)} samples, {read.drive.time[-1]:.0f} s; speed "
        f"{1000 * read.delay:.0f} ms behind power, corrected; dropped: {dropped or 'nothing'}"
    )


def _label(settings: Settings, quick: bool) -> str:
    text = (
        f"{settings.optimizer.value}, {settings.epochs} epochs (energy networks "
        f"{settings.energy_epochs}), seed {settings.seed}, eq. 21 as {settings.form.value}"
    )
    published = settings.optimizer is OptimizerName.ADAM and settings.epochs == PUBLISHED_EPOCHS
    if quick:
        return f"QUICK LOOK: {text}. {_left_out(settings)}"
    return f"as published: {text}" if published else f"not as published: {text}"


def _left_out(settings: Settings) -> str:
    adam = settings.optimizer is OptimizerName.ADAM
    trained = f"{settings.epochs} of" if adam else f"{settings.optimizer.value} in place of"
    return (
        f"Shortened: {trained} the paper's {PUBLISHED_EPOCHS} epochs of adam, and "
        f"{settings.energy_epochs} of {ENERGY_EPOCHS} epochs of the energy networks. Leave out "
        "--quick and --optimizer to run them all."
    )


@contextmanager
def training_progress() -> Iterator[OnProgress]:
    """Yields a function that shows the progress of each training, on a terminal with the loss."""
    shown: dict[str, Report] = {}
    with ExitStack() as bar:

        def show(title: str, epoch: int, epochs: int, loss: float) -> None:
            if title not in shown:
                bar.close()
                # The time left is for this training alone.
                numbered = f"{title}, {TRAININGS.index(title) + 1} of {len(TRAININGS)}"
                unit = f"of {epochs} epochs"
                shown[title] = bar.enter_context(progress_bar(numbered, epochs, unit))
            shown[title](epoch, f"loss {loss:.2e}")

        yield show


def _print(table: ResultTable) -> None:
    shown = PlainTable(table.title, table.columns, table.rows, unbroken=table.columns[:1])
    show(shown, at_least=0 if results.is_terminal else FILE_WIDTH)
    say(table.note, style="dim")
    say()


def _write(outcome: Outcome, read: ReadLog, folder: Path, log: Path, label: str) -> None:
    command = command_line()
    report, numbers = folder / "report.html", folder / "results.json"
    state, vehicle = folder / "state.json", folder / "vehicle.yaml"
    with as_input_error(f"{folder}: cannot be written"):
        write_reproduction(report, outcome, command, label)
        document = {
            "command": command,
            "log": {"path": str(log), "delay_s": read.delay, "dropped": dict(read.dropped)},
            **results_of(outcome),
        }
        write_json(numbers, document)
        write_estimator_state(state, outcome)
        write_vehicle_file(vehicle, outcome, log.name)
    for path, use in (
        (report, "every table and figure"),
        (numbers, "the same as numbers"),
        (state, f"start of an estimator: evpinn replay --mode paper --state {state}"),
        (vehicle, f"vehicle file with what was found: --vehicle {vehicle}"),
    ):
        note(f"{path}: {use}")


def results_of(outcome: Outcome) -> dict[str, Any]:
    """All measured results, as values for `json`."""
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
            "random": [_loss_row(row) for row in outcome.training.rows],
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
