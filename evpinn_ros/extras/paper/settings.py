"""Names of the ways to train (`extras.paper.optimizers`), apart so that help needs no torch."""

from __future__ import annotations

from enum import Enum


class OptimizerName(str, Enum):
    """Names that `evpinn reproduce --optimizer` takes."""

    ADAM = "adam"
    ADAM_LBFGS = "adam_lbfgs"
    GAUSS_NEWTON = "gauss_newton"


DEFAULT_EPOCHS = {
    OptimizerName.ADAM: 10_000,
    OptimizerName.ADAM_LBFGS: 3000,
    OptimizerName.GAUSS_NEWTON: 400,
}
