"""The choice of an optimizer for `mode: paper`, apart from the code that needs torch."""

from __future__ import annotations

from enum import Enum


class PaperOptimizer(str, Enum):
    """Optimizer of `estimation.paper` for the network and the parameters on its window."""

    ADAM = "adam"  # as published
    GAUSS_NEWTON = "gauss_newton"  # the same network and loss, much nearer to the minimum
