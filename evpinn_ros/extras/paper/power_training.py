"""Training of the power network, logged at the epochs of Tables II and III, resumable."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math

import numpy as np
import torch

from evpinn_ros.common.errors import InputError
from evpinn_ros.extras.paper.optimizer_name import OptimizerName
from evpinn_ros.extras.paper.optimizers import OPTIMIZERS
from evpinn_ros.extras.paper.problem import Problem
from evpinn_ros.extras.paper.published import LOGGED_EPOCHS, Losses, LossRow

CURVE_POINTS = 120  # of Fig. 5 and 6, evenly spread over the logarithm of the epoch
OnEpoch = Callable[[int, float], None]  # takes the epoch and the newest validation loss


def curve_epochs(last: int) -> list[int]:
    """Epochs at which losses are logged: those of the tables, the last, and for the figure."""
    spread = np.geomspace(1, last, CURVE_POINTS).round().astype(int).tolist()
    return sorted({*spread, *(epoch for epoch in LOGGED_EPOCHS if epoch <= last), last})


class PowerTraining:
    """One optimiser on one problem.

    Attributes:
        epoch: how far it is.
        rows: losses at `curve_epochs` so far.
    """

    def __init__(self, name: OptimizerName, problem: Problem, epochs: int, seed: int) -> None:
        """Begin at epoch 0 of `epochs`."""
        self.problem = problem
        self.optimizer = OPTIMIZERS[name](problem, seed)
        self.epoch = 0
        self.epochs = epochs
        self.rows: list[LossRow] = []
        self._logged = set(curve_epochs(epochs))

    def run_to(self, epoch: int, on_epoch: OnEpoch | None = None) -> None:
        """Train up to an epoch.

        Raises:
            InputError: a loss is no longer finite.
        """
        while self.epoch < min(epoch, self.epochs):
            self.optimizer.step()
            self.epoch += 1
            if self.epoch in self._logged:
                self._log()
            if on_epoch is not None and self.rows:
                on_epoch(self.epoch, self.rows[-1].validation.total)

    def state(self) -> dict[str, torch.Tensor]:
        """State that `load_state` needs to go on with the same numbers."""
        rows = [(row.epoch, *row.training, *row.validation) for row in self.rows]
        return {
            **self.optimizer.state(),
            "epoch_done": torch.tensor(self.epoch),
            "rows": torch.tensor(rows, dtype=torch.float64),
        }

    def load_state(self, state: Mapping[str, torch.Tensor]) -> None:
        """Go on from `state`."""
        self.optimizer.load_state(state)
        self.epoch = int(state["epoch_done"])
        self.rows = [
            LossRow(int(row[0]), Losses(*row[1:4]), Losses(*row[4:7]))
            for row in state["rows"].tolist()
        ]

    def _log(self) -> None:
        problem, network = self.problem, self.optimizer.network
        log_scale = self.optimizer.log_scale.detach()
        row = LossRow(
            self.epoch,
            problem.losses(problem.training, network, log_scale),
            problem.losses(problem.validation, network, log_scale),
        )
        if not all(math.isfinite(loss) for loss in (*row.training, *row.validation)):
            raise InputError(f"the training diverged before epoch {self.epoch}")
        self.rows.append(row)
