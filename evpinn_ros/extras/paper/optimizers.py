"""Three optimizers of network and parameters for a `Problem`.

- `Adam`: as published, full batch, one learning rate for the layers and one for the parameters.

- `AdamThenLbfgs`: the usual improvement of Adam in the literature on PINNs.

- `GaussNewton`: ours. It solves for the parameters (`Problem.fit`), and trains the network by dual
Gauss-Newton steps on random batches. Units of the first layer start spread over the drive: by
Glorot's rule all have their kinks near t = 0.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
import math

import numpy as np
import torch

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.extras.paper.checkpoint import adam_state, load_adam_state
from evpinn_ros.extras.paper.gauss_newton import gauss_newton_step
from evpinn_ros.extras.paper.log_parameters import LEARNED
from evpinn_ros.extras.paper.network import (
    PAPER_WIDTHS,
    PHYSICS_LOSS,
    PowerNetwork,
    paper_adam,
    spread_over_time,
)
from evpinn_ros.extras.paper.problem import InputForm, Problem
from evpinn_ros.extras.paper.published import LOGGED_EPOCHS, Losses, LossRow
from evpinn_ros.extras.paper.settings import OptimizerName

ADAM_EPOCHS_BEFORE_LBFGS = 1000
LBFGS_MEMORY = 50
LBFGS_EVALUATIONS = 25  # of the loss in one line search

BATCH = 1000  # samples of a Gauss-Newton step: the unknowns of its system
STEP = 0.5  # share of each Gauss-Newton step: a batch is not the drive
FULL_STEPS = 100  # then the share and its noise fall as 1 / n (Robbins, Monro)
DAMPING = 1e-4  # of the mean diagonal
PARAMETERS_EVERY = 10  # steps between solutions for the parameters
KINK_SHARPNESS = 3.0  # distance of two kinks over the width of one

CURVE_POINTS = 120  # of Fig. 5 and 6, evenly spaced in the logarithm of the epoch
OnEpoch = Callable[[int, float], None]  # takes the epoch and the newest validation loss

# Raw inputs were best for Adam. Gauss-Newton needs inputs of similar size.
INPUTS = {
    OptimizerName.ADAM: InputForm.RAW,
    OptimizerName.ADAM_LBFGS: InputForm.RAW,
    OptimizerName.GAUSS_NEWTON: InputForm.UNIT,
}


def curve_epochs(last: int) -> list[int]:
    """Epochs with logged losses: those of the tables and of the figure, and the last."""
    spread = np.geomspace(1, last, CURVE_POINTS).round().astype(int).tolist()
    return sorted({*spread, *(epoch for epoch in LOGGED_EPOCHS if epoch <= last), last})


class Optimizer(ABC):
    """Trains on a problem; resumed from `state()` it repeats (except L-BFGS's memory)."""

    def __init__(self, problem: Problem, epochs: int, seed: int) -> None:
        """Begin with an untrained network, to be trained for `epochs` in total."""
        self.problem = problem
        network = PowerNetwork(PAPER_WIDTHS, seed=seed, dtype=problem.dtype)
        self.network = network.to(problem.device)  # of Fig. 4, by Glorot's rule
        self.log_scale = torch.zeros(len(LEARNED), dtype=problem.dtype, device=problem.device)
        self.epoch, self.epochs = 0, epochs  # trained so far, and in total
        self.rows: list[LossRow] = []  # losses at `curve_epochs` so far
        self._logged = set(curve_epochs(epochs))

    @abstractmethod
    def step(self) -> None:
        """Train for one epoch, number `epoch`."""

    @property
    def values(self) -> Parameters:
        """The parameters found so far."""
        return self.problem.values(self.log_scale)

    def run_to(self, epoch: int, on_epoch: OnEpoch | None = None) -> None:
        """Train up to an epoch; InputError if a loss is not finite."""
        while self.epoch < min(epoch, self.epochs):
            self.epoch += 1
            self.step()
            if self.epoch in self._logged:
                self._log()
            if on_epoch is not None and self.rows:
                on_epoch(self.epoch, self.rows[-1].validation.total)

    def state(self) -> dict[str, torch.Tensor]:
        """State that a resumed training needs, besides the problem and the seed."""
        rows = [(row.epoch, *row.training, *row.validation) for row in self.rows]
        return {
            "weights": self.network.vector(),
            "log_scale": self.log_scale.detach().clone(),
            "epoch_done": torch.tensor(self.epoch),
            "rows": torch.tensor(rows, dtype=torch.float64),
        }

    def load_state(self, state: Mapping[str, torch.Tensor]) -> None:
        """Go on from `state`."""
        self.network.load_vector(state["weights"].to(self.problem.device))
        with torch.no_grad():
            self.log_scale.copy_(state["log_scale"])
        self.epoch = int(state["epoch_done"])
        self.rows = [
            LossRow(int(row[0]), Losses(*row[1:4]), Losses(*row[4:7]))
            for row in state["rows"].tolist()
        ]

    def _log(self) -> None:
        problem, log_scale = self.problem, self.log_scale.detach()
        training, validation = (
            problem.losses(samples, self.network, log_scale)
            for samples in (problem.training, problem.validation)
        )
        if not all(map(math.isfinite, (*training, *validation))):
            raise InputError(f"the training diverged before epoch {self.epoch}")
        self.rows.append(LossRow(self.epoch, training, validation))


class Adam(Optimizer):
    """Adam as published (section III.D)."""

    def __init__(self, problem: Problem, epochs: int, seed: int) -> None:
        super().__init__(problem, epochs, seed)
        self.log_scale.requires_grad_()
        self._adam = paper_adam(self.network, self.log_scale)

    def loss(self) -> torch.Tensor:
        """Loss of eq. 22 on the training data; computes its gradients."""
        self._adam.zero_grad()
        data, physics = self.problem.terms(self.problem.training, self.network, self.log_scale)
        total = data + physics
        total.backward()  # type: ignore[no-untyped-call]
        return total

    def step(self) -> None:
        """One update of all weights, by the loss of the whole drive."""
        self.loss()
        self._adam.step()

    def trained(self) -> list[torch.Tensor]:
        """The trained tensors: weights and log parameters."""
        return [*self.network.parameters(), self.log_scale]

    def state(self) -> dict[str, torch.Tensor]:
        """Weights, z and Adam's moments."""
        return super().state() | adam_state(self._adam, self.trained())

    def load_state(self, state: Mapping[str, torch.Tensor]) -> None:
        """Go on from `state`."""
        super().load_state(state)
        load_adam_state(self._adam, self.trained(), state)


class AdamThenLbfgs(Adam):
    """`ADAM_EPOCHS_BEFORE_LBFGS` epochs of Adam, then L-BFGS with a line search."""

    def __init__(self, problem: Problem, epochs: int, seed: int) -> None:
        super().__init__(problem, epochs, seed)
        self._lbfgs = torch.optim.LBFGS(
            self.trained(),
            max_iter=1,
            max_eval=LBFGS_EVALUATIONS,  # PyTorch's default for one iteration is one: no step
            history_size=LBFGS_MEMORY,
            line_search_fn="strong_wolfe",
        )

    def step(self) -> None:
        """One step of Adam, or one iteration of L-BFGS."""
        if self.epoch <= ADAM_EPOCHS_BEFORE_LBFGS:
            super().step()
        else:
            self._lbfgs.step(self.loss)


class GaussNewton(Optimizer):
    """Solves for the parameters, trains the network by dual Gauss-Newton on random batches."""

    def __init__(self, problem: Problem, epochs: int, seed: int) -> None:
        super().__init__(problem, epochs, seed)
        self._generator = torch.Generator().manual_seed(seed)
        spread_over_time(self.network, self._generator, -1.0, 1.0, KINK_SHARPNESS)
        self.log_scale = problem.fit(problem.training, problem.training.power).log_scale

    @torch.no_grad()
    def step(self) -> None:
        """Train on one batch; every `PARAMETERS_EVERY` steps solve for the parameters."""
        samples, network = self.problem.training, self.network
        if (self.epoch - 1) % PARAMETERS_EVERY == 0 and self.epoch > 1:
            fit = self.problem.fit(samples, network(samples.inputs), self.log_scale)
            self.log_scale = fit.log_scale
        rows = torch.randperm(len(samples.power), generator=self._generator)[:BATCH]
        rows = rows.to(self.problem.device)
        physics = self.problem.physics(samples, self.log_scale)[rows]
        target = (samples.power[rows] + PHYSICS_LOSS * physics) / (1.0 + PHYSICS_LOSS)
        step = gauss_newton_step(network, samples.inputs[rows], target, DAMPING)
        share = STEP * min(1.0, FULL_STEPS / self.epoch)
        network.load_vector(network.vector() + share * step)

    def state(self) -> dict[str, torch.Tensor]:
        """Weights, z, and the state of the random batches."""
        return super().state() | {"generator": self._generator.get_state()}

    def load_state(self, state: Mapping[str, torch.Tensor]) -> None:
        """Go on from `state`."""
        super().load_state(state)
        self._generator.set_state(state["generator"])


OPTIMIZERS: Mapping[OptimizerName, type[Optimizer]] = {
    OptimizerName.ADAM: Adam,
    OptimizerName.ADAM_LBFGS: AdamThenLbfgs,
    OptimizerName.GAUSS_NEWTON: GaussNewton,
}
