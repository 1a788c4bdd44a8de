"""DeepXDE (Lu et al., SIAM Review 63, 2021) on the same inverse problem, as its users would.

Five `dde.Variable`, the physics of eq. 21 as residual with the acceleration as auxiliary variable,
the measured power as `PointSetBC`, lambda as loss weight, its Adam at 1e-3 for everything. It asks
its network for the points of data and of physics apart, though they are the same ones here, which
doubles its work; that is how the library is made. Optional: `pip install evpinn_ros[bench]`.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
import os
from typing import Any

import numpy as np
import torch

from evpinn_ros.paper.log_parameters import LEARNED
from evpinn_ros.paper.network import NETWORK_RATE, PAPER_WIDTHS, PHYSICS_LOSS
from evpinn_ros.reproduction.problem import PhysicsInputs, Problem


def deepxde_version() -> str | None:
    """Version of the installed DeepXDE, None if there is none."""
    try:
        return version("deepxde")
    except PackageNotFoundError:
        return None


class DeepXdeTraining:
    """The problem as a `dde.Model`; raw inputs alone, as for Adam as published.

    Attributes:
        log_scale: z of the five parameters, a `dde.Variable` each.
    """

    def __init__(self, problem: Problem, seed: int) -> None:
        os.environ.setdefault("DDE_BACKEND", "pytorch")
        import deepxde

        self._problem, self._deepxde = problem, deepxde
        deepxde.config.set_random_seed(seed)
        samples = problem.training
        points = samples.inputs.numpy()
        moments, accelerations = points[:, 1], samples.motion.acceleration.numpy()
        self.log_scale = [deepxde.Variable(0.0) for _ in LEARNED]

        def residual(inputs: Any, power: Any, acceleration: Any) -> Any:
            motion = PhysicsInputs(inputs[:, 0], acceleration[:, 0])
            return problem.physics(motion, torch.stack(self.log_scale))[:, None] - power

        def acceleration_at(inputs: np.ndarray) -> np.ndarray:
            found = np.interp(inputs[:, 1], moments, accelerations)
            return np.asarray(found[:, None], dtype=np.float32)

        data = deepxde.data.PDE(
            deepxde.geometry.PointCloud(points),
            residual,
            [deepxde.icbc.PointSetBC(points, samples.power.numpy()[:, None])],
            anchors=points,
            auxiliary_var_function=acceleration_at,
        )
        network = deepxde.nn.FNN(list(PAPER_WIDTHS), "tanh", "Glorot normal")
        self._model = deepxde.Model(data, network)
        self._model.compile(
            "adam",
            lr=NETWORK_RATE,
            loss_weights=[PHYSICS_LOSS, 1.0],
            external_trainable_variables=self.log_scale,
            verbose=0,
        )

    def train(self, epochs: int, after_epoch: Callable[[], bool]) -> None:
        """Train until this many epochs are done or `after_epoch` says stop."""
        model = self._model

        class AfterEpoch(self._deepxde.callbacks.Callback):  # type: ignore[name-defined]
            def on_epoch_end(self) -> None:
                model.stop_training = after_epoch()

        model.train(
            iterations=epochs, display_every=epochs + 1, callbacks=[AfterEpoch()], verbose=0
        )

    @torch.no_grad()
    def validation_loss(self) -> float:
        """Total loss on the validation data, the very one of `Problem.losses`."""
        log_scale = torch.stack([variable.detach() for variable in self.log_scale])
        problem, network = self._problem, self._model.net
        return problem.losses(
            problem.validation, lambda inputs: network(inputs)[:, 0], log_scale
        ).total
