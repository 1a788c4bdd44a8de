"""Settings of `mode: paper`, apart from the code that needs torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

from evpinn_ros.estimation.estimator import EstimatorSettings, Mode
from evpinn_ros.estimation.learner import Learner
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.physics import RegenForm


class PaperOptimizer(str, Enum):
    """Optimizer of `paper.learner` for the network and the parameters on its window."""

    ADAM = "adam"  # as published
    GAUSS_NEWTON = "gauss_newton"  # the same network and loss, much nearer to the minimum


@dataclass(frozen=True, slots=True)
class PaperSettings(EstimatorSettings):
    """Settings of an estimator that learns as published.

    Attributes:
        regen_form: reading of eq. 21.
        optimizer: what trains.
    """

    mode: ClassVar[Mode] = Mode.PAPER
    regen_form: RegenForm = RegenForm.RECOVERY
    optimizer: PaperOptimizer = PaperOptimizer.ADAM

    def new_learner(self, vehicle: Vehicle) -> Learner:
        """A learner that knows the vehicle file alone."""
        # Imported here: it alone needs torch, which takes longer to load than all else together.
        from evpinn_ros.paper.learner import PaperLearner

        return PaperLearner(
            vehicle, seed=self.seed, form=self.regen_form, optimizer=self.optimizer
        )


SETTINGS: Mapping[Mode, type[EstimatorSettings]] = {
    kind.mode: kind for kind in (EstimatorSettings, PaperSettings)
}
"""Settings of each mode."""
