"""Settings of the paper's experiment, without torch, so that --help is fast."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

from evpinn_ros.core.vehicle.physics import RegenForm


class OptimizerName(str, Enum):
    """Names of `extras.paper.optimizers` for `evpinn reproduce --optimizer`."""

    ADAM = "adam"
    ADAM_LBFGS = "adam_lbfgs"
    GAUSS_NEWTON = "gauss_newton"


ENERGY_EPOCHS = PUBLISHED_EPOCHS = 10_000
QUICK_ENERGY_EPOCHS = 1000
DEFAULT_EPOCHS = {
    OptimizerName.ADAM: 10_000,
    OptimizerName.ADAM_LBFGS: 3000,
    OptimizerName.GAUSS_NEWTON: 400,
}
QUICK_EPOCHS = {
    OptimizerName.ADAM: 300,
    OptimizerName.ADAM_LBFGS: 1200,
    OptimizerName.GAUSS_NEWTON: 200,
}


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of a run."""

    optimizer: OptimizerName  # of the power network
    epochs: int  # of the power network
    energy_epochs: int  # of the energy networks
    seed: int = 0  # of split, networks and batches
    device: str = "cpu"  # `cpu` or `cuda`
    form: RegenForm = RegenForm.RECOVERY  # of eq. 21

    @classmethod
    def chosen(
        cls, optimizer: OptimizerName | None, epochs: int | None, quick: bool, **others: Any
    ) -> Settings:
        """Settings with the defaults of a quick or a whole run in place of None."""
        optimizer = optimizer or (OptimizerName.GAUSS_NEWTON if quick else OptimizerName.ADAM)
        epochs = epochs or (QUICK_EPOCHS if quick else DEFAULT_EPOCHS)[optimizer]
        energy_epochs = QUICK_ENERGY_EPOCHS if quick else ENERGY_EPOCHS
        return cls(optimizer, epochs, energy_epochs, **others)
