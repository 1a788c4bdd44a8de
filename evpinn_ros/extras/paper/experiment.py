"""The paper's experiment on one drive: trainings, tables and baselines.

It runs three resumable trainings: the power network under the paper's random split and under a
chronological one, and the energy networks; then the baselines of `scores` on the same samples.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import hashlib
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evpinn_ros.common.arrays import chosen_rows
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.extras.paper.checkpoint import load_checkpoint, save_checkpoint
from evpinn_ros.extras.paper.drive_log import DriveLog
from evpinn_ros.extras.paper.energy_network import EnergyTraining, StepData, step_data
from evpinn_ros.extras.paper.log_parameters import standing_load
from evpinn_ros.extras.paper.optimizers import INPUTS, OPTIMIZERS, Optimizer
from evpinn_ros.extras.paper.problem import (
    Problem,
    SampleSplit,
    Scale,
    chronological_split,
    random_split,
)
from evpinn_ros.extras.paper.published import PREDICTED, EnergyRow
from evpinn_ros.extras.paper.scores import (
    PowerScore,
    TableFiveRow,
    combination_rows,
    drift_included,
    exact_energy,
    least_squares_power,
    parameter_rows,
    power_score,
)
from evpinn_ros.extras.paper.settings import OptimizerName, Settings

CHECKPOINT_EVERY = 100  # epochs
CHECKPOINT_VERSION = 2  # of the content of a file and of the training's constants
PROGRESS_EVERY = 10  # epochs
RANDOM, CHRONOLOGICAL, WHOLE = "random 20 %", "last 20 %", "all of it"
NETWORK, TIME_HELD = "network", "network, time held"
BASELINES = {RANDOM: "baseline: line in time", CHRONOLOGICAL: "baseline: last power held"}
REGRESSION = "eq. 21, least squares"

# Takes the title of a training, its epoch, its last epoch and the newest loss.
OnProgress = Callable[[str, int, int, float], None]
TRAININGS = ("power network", "chronological split", "energy networks")  # in their order


class Scored(NamedTuple):
    """A method's score on the validation data of a split, or on the whole drive."""

    method: str
    split: str
    score: PowerScore


class EnergyCurves(NamedTuple):
    """Energy since the first sample, J, shape (n,) each."""

    measured: np.ndarray  # exact integral of the measured power
    predicted: np.ndarray  # exact integral of the network's power
    rknn: np.ndarray  # the Runge-Kutta network of the paper, rolled out over the measured power
    dnn: np.ndarray  # the plain network, also rolled out


@dataclass(frozen=True, slots=True)
class Outcome:
    """Results behind the tables, figures and files."""

    log: DriveLog
    vehicle: Vehicle
    settings: Settings
    training: Optimizer  # under the paper's random split
    chronological: Optimizer
    energy_rows: list[EnergyRow]
    scores: list[Scored]
    parameters: list[TableFiveRow]
    combinations: list[TableFiveRow]
    regression: Parameters
    covariance: np.ndarray
    predicted_power: np.ndarray
    unseen_power: np.ndarray
    energies: EnergyCurves


class Experiment:
    """Runs the trainings of one drive, and saves each in a folder."""

    def __init__(self, log: DriveLog, vehicle: Vehicle, settings: Settings, folder: Path) -> None:
        self._log, self._vehicle, self._settings = log, vehicle.as_published, settings
        self._folder = folder

    def run(self, on_progress: OnProgress) -> Outcome:
        """Finish all trainings and score them; InputError if a training diverged."""
        log, settings = self._log, self._settings
        steps = step_data(log.time, log.power)  # first, to refuse a wrong log at once
        count = len(log.time)
        split = random_split(count, settings.seed)
        training = self._power(TRAININGS[0], split, on_progress)
        later = self._power(TRAININGS[1], chronological_split(count), on_progress)
        energy = self._energy(steps, on_progress)
        problem = training.problem
        covariance = problem.covariance(training.log_scale)
        if settings.optimizer is not OptimizerName.GAUSS_NEWTON:
            covariance = drift_included(self._vehicle, training.log_scale, covariance)
        predicted = problem.predicted_power(training.network, log)
        rknn, dnn = energy.integrate(log.time, log.power)
        rows = (self._vehicle, training.values, covariance, settings.form)
        return Outcome(
            log=log,
            vehicle=self._vehicle,
            settings=settings,
            training=training,
            chronological=later,
            energy_rows=energy.losses,
            scores=[
                *_scores(training, RANDOM),
                *_scores(later, CHRONOLOGICAL),
                *self._whole_drive(),
            ],
            parameters=parameter_rows(*rows),
            combinations=combination_rows(*rows),
            regression=least_squares_power(problem)[1],
            covariance=covariance,
            predicted_power=predicted,
            unseen_power=later.problem.predicted_power(later.network, log),
            energies=EnergyCurves(
                measured=exact_energy(log.time, log.power),
                predicted=exact_energy(log.time, predicted),
                rknn=rknn,
                dnn=dnn,
            ),
        )

    def _power(self, title: str, split: SampleSplit, on_progress: OnProgress) -> Optimizer:
        settings = self._settings
        problem = Problem(
            self._log,
            self._vehicle,
            split,
            form=settings.form,
            inputs=INPUTS[settings.optimizer],
            device=settings.device,
        )
        training = OPTIMIZERS[settings.optimizer](problem, settings.epochs, settings.seed)
        made_of = (settings.optimizer.value, settings.form.value, settings.seed, settings.epochs)
        self._train(title, training, made_of, on_progress)
        return training

    def _energy(self, steps: StepData, on_progress: OnProgress) -> EnergyTraining:
        settings = self._settings
        training = EnergyTraining(steps, seed=settings.seed, device=settings.device)
        made_of = (settings.seed, settings.energy_epochs)
        self._train(TRAININGS[2], training, made_of, on_progress)
        return training

    def _train(
        self,
        title: str,
        training: Optimizer | EnergyTraining,
        settings: tuple[object, ...],
        on_progress: OnProgress,
    ) -> None:
        """Continue a training from its file to its end, the last of `settings`."""
        epochs = int(str(settings[-1]))
        # The key has all inputs of the training; each key has its own file.
        data = hashlib.sha256(b"".join(column.tobytes() for column in self._log)).hexdigest()
        vehicle = hashlib.sha256(repr(self._vehicle).encode()).hexdigest()
        key = json.dumps([CHECKPOINT_VERSION, title, data, vehicle, *map(str, settings)])
        name = hashlib.sha256(key.encode()).hexdigest()[:12]
        path = self._folder / f"{title.replace(' ', '_')}-{name}.npz"
        saved = load_checkpoint(path, key)
        if saved is not None:
            training.load_state(saved)

        def show(epoch: int, loss: float) -> None:
            if epoch % PROGRESS_EVERY == 0 or epoch == epochs:
                on_progress(title, epoch, epochs, loss)

        while training.epoch < epochs:
            training.run_to(min(training.epoch + CHECKPOINT_EVERY, epochs), show)
            save_checkpoint(path, key, training.state())

    def _whole_drive(self) -> list[Scored]:
        vehicle, log = self._vehicle, self._log
        p_aux = standing_load(log.speed, log.power, vehicle.initial.p_aux)
        candidates: Mapping[str, Parameters] = {
            "initial guess": vehicle.initial._replace(p_aux=p_aux)
        }
        if vehicle.key in PREDICTED:
            published = PREDICTED[vehicle.key]._replace(p_aux=p_aux)
            candidates = {**candidates, "Table V": published}
        scale = Scale.of(log.power)
        scored = []
        for title, parameters in candidates.items():
            for form in (RegenForm.PRINTED, RegenForm.RECOVERY):
                power = vehicle.power(log.speed, log.acceleration, parameters, form)
                score = power_score(power, log.power, scale)
                scored.append(Scored(f"{title}, {form.value}", WHOLE, score))
        return scored


def _scores(training: Optimizer, split: str) -> list[Scored]:
    problem = training.problem
    log, rows = problem.log, problem.split
    trained, held = (chosen_rows(log, part) for part in rows)
    powers = {
        NETWORK: problem.predicted_power(training.network, held),
        REGRESSION: least_squares_power(problem)[0],
        # Interpolated between neighbouring training samples; held after the last one.
        BASELINES[split]: np.interp(held.time, trained.time, trained.power),
    }
    if split == CHRONOLOGICAL:
        last = held._replace(time=np.minimum(held.time, trained.time[-1]))
        powers[TIME_HELD] = problem.predicted_power(training.network, last)
    return [
        Scored(method, split, power_score(power, held.power, problem.scale))
        for method, power in powers.items()
    ]
