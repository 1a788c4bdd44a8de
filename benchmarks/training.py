"""Time that each way of training takes to the loss that Adam as published ends with.

All on the same drive, network, split and loss, in one run, process and thread, each after a step
of warm-up. Its beginning and its training count; the clock stands still while the validation loss
is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
import math
import time
from typing import NamedTuple, Protocol

import torch

from benchmarks.deepxde_peer import DeepXdeTraining, deepxde_version
from evpinn_ros.paper.network import spread_over_time
from evpinn_ros.reproduction.drive_log import DriveLog
from evpinn_ros.reproduction.optimizers import (
    INPUTS,
    KINK_SHARPNESS,
    OPTIMIZERS,
    Adam,
    Optimizer,
    OptimizerName,
)
from evpinn_ros.reproduction.problem import InputForm, Problem, random_split
from evpinn_ros.vehicle.files import Vehicle

CHECK_EVERY = {OptimizerName.GAUSS_NEWTON: 1}  # epochs between looks at the validation loss
CHECK_OTHERS_EVERY = 10
TITLES = {
    OptimizerName.ADAM: "Adam as published",
    OptimizerName.ADAM_LBFGS: "Adam, then L-BFGS",
    OptimizerName.GAUSS_NEWTON: "Gauss-Newton (ours)",
}
OnEpoch = Callable[[str, int, int, float], None]  # title, epoch, last epoch, validation loss


@dataclass(frozen=True, slots=True)
class Timed:
    """One way of training."""

    title: str  # of it
    epochs: int  # run
    seconds: float  # spent on training
    best: float  # least total validation loss seen
    best_epoch: int  # at which it was first seen
    best_seconds: float  # of training up to there
    reached: bool  # whether `best` came down to the loss asked for


class Training(Protocol):
    """One way of training, begun afresh."""

    def train(self, epochs: int, after_epoch: Callable[[], bool]) -> None:
        """Train until this many epochs are done or `after_epoch` says stop."""

    def validation_loss(self) -> float:
        """Total validation loss now."""


class Contender(NamedTuple):
    """A way of training: its title, how to begin it, epochs between looks at its loss."""

    title: str
    begin: Callable[[], Training]
    every: int


def bench_training(
    log: DriveLog, vehicle: Vehicle, epochs: int, seed: int, on_epoch: OnEpoch
) -> Iterator[Timed]:
    """Run every way of training, Adam as published first: the others stop at its best loss.

    Adam's own time is that to its best loss, not that of all its epochs.

    The others stop at `epochs` too, if they have not reached its loss; `on_epoch` takes the
    losses.
    """
    stop = -math.inf
    for contender in _contenders(log, vehicle, seed):
        timed = time_to_loss(contender, epochs, stop, on_epoch)
        if contender.title == TITLES[OptimizerName.ADAM]:
            stop = timed.best
        yield timed


def _contenders(log: DriveLog, vehicle: Vehicle, seed: int) -> Iterator[Contender]:
    split = random_split(len(log.time), seed)
    raw, unit = (Problem(log, vehicle, split, inputs=form) for form in InputForm)

    def ours(name: OptimizerName) -> Contender:
        problem = raw if INPUTS[name] is InputForm.RAW else unit
        return Contender(
            TITLES[name],
            lambda: _Ours(problem, OPTIMIZERS[name](problem, seed)),
            CHECK_EVERY.get(name, CHECK_OTHERS_EVERY),
        )

    def spread_adam() -> Training:
        adam = Adam(unit, seed)
        spread_over_time(
            adam.network, torch.Generator().manual_seed(seed), -1.0, 1.0, KINK_SHARPNESS
        )
        return _Ours(unit, adam)

    yield from (ours(name) for name in OptimizerName)
    yield Contender("Adam from our start", spread_adam, CHECK_OTHERS_EVERY)
    version = deepxde_version()
    if version is not None:
        title = f"DeepXDE {version}, its defaults"
        yield Contender(title, lambda: DeepXdeTraining(raw, seed), CHECK_OTHERS_EVERY)


class _Ours:
    """An optimiser of this package as a `Training`."""

    def __init__(self, problem: Problem, optimizer: Optimizer) -> None:
        self._problem, self._optimizer = problem, optimizer

    def train(self, epochs: int, after_epoch: Callable[[], bool]) -> None:
        for _ in range(epochs):
            self._optimizer.step()
            if after_epoch():
                return

    def validation_loss(self) -> float:
        problem, optimizer = self._problem, self._optimizer
        log_scale = optimizer.log_scale.detach()
        return problem.losses(problem.validation, optimizer.network, log_scale).total


def time_to_loss(contender: Contender, epochs: int, stop: float, on_epoch: OnEpoch) -> Timed:
    """Train one contender, after a step of warm-up, until its validation loss reaches `stop`."""
    warm_up = contender.begin()
    warm_up.train(1, lambda: True)
    warm_up.validation_loss()
    clock = _Clock(contender, epochs, stop, on_epoch)
    clock.training.train(epochs, clock.after_epoch)
    reached = clock.best <= stop
    return Timed(contender.title, clock.epoch, clock.seconds, *clock.best_at, reached)


class _Clock:
    """Counts epochs and seconds of training, and says when the loss is reached."""

    def __init__(self, contender: Contender, epochs: int, stop: float, on_epoch: OnEpoch) -> None:
        self._contender, self._epochs = contender, epochs
        self._stop, self._on_epoch = stop, on_epoch
        self.epoch, self.seconds = 0, 0.0
        self.best_at = (math.inf, 0, 0.0)  # loss, epoch, seconds
        self._since = time.perf_counter()
        self.training = contender.begin()

    def after_epoch(self) -> bool:
        """True if training is to stop."""
        self.epoch += 1
        if self.epoch % self._contender.every and self.epoch < self._epochs:
            return False
        self.seconds += time.perf_counter() - self._since
        loss = self.training.validation_loss()
        self.best_at = min(self.best_at, (loss, self.epoch, self.seconds))
        self._on_epoch(self._contender.title, self.epoch, self._epochs, loss)
        self._since = time.perf_counter()
        return loss <= self._stop

    @property
    def best(self) -> float:
        """Least validation loss seen."""
        return self.best_at[0]
