"""Gauss-Newton in the space of residuals, for networks with far more weights than samples.

The damped step dw = (J^T J + d I)^-1 J^T r of the weights equals

    dw = J^T (J J^T + d I)^-1 r

(push-through identity), a system with one unknown per sample instead of one per weight: 1000
instead of 50 049. For a fully connected network J is never formed. With the activations A_l that
enter layer l and the derivatives D_l of the output by the outputs of layer l,

    J J^T = sum over l of (A_l A_l^T + 1) o (D_l D_l^T)      (o elementwise)

and J^T a is one more product per layer (dual Gauss-Newton: Jnini et al., arXiv 2505.21404).
"""

from __future__ import annotations

import torch

from evpinn_ros.extras.paper.network import PowerNetwork

LEAST_DAMPING = 1e-3  # of `levenberg_marquardt`; keeps undetermined directions
LESS, MORE = 1.0 / 3.0, 5.0  # factors of the damping after an accepted and a refused step
MOST_DAMPING = 1.0  # of the mean diagonal; above it a step is a gradient step


class Linearised:
    """A network linearised at its present weights, for some samples."""

    @torch.no_grad()
    def __init__(self, network: PowerNetwork, inputs: torch.Tensor, target: torch.Tensor) -> None:
        """Linearise for inputs, shape (n, inputs), and wanted outputs, shape (n,)."""
        output, *layers = network.sweep(inputs)
        self._layers = list(zip(*layers, strict=True))
        self.residual = target - output  # target minus output, shape (n,)
        self.system = inputs.new_zeros(len(inputs), len(inputs))  # J J^T, shape (n, n)
        for entering, derivative in self._layers:
            self.system += (entering @ entering.T + 1.0) * (derivative @ derivative.T)

    @torch.no_grad()
    def step(self, damping: float) -> torch.Tensor | None:
        """The step of all weights towards the target; None if numerically singular.

        `damping` is d over the mean diagonal of J J^T; weights are in the order of
        `PowerNetwork.vector`.
        """
        damped = self.system.clone()
        damped.diagonal().add_(damping * self.system.diagonal().mean())
        factor, failed = torch.linalg.cholesky_ex(damped)
        dual = torch.cholesky_solve(self.residual[:, None], factor)
        parts: list[torch.Tensor] = []
        for entering, derivative in self._layers:
            weighted = derivative * dual
            parts += [(weighted.T @ entering).flatten(), weighted.sum(0)]
        step = torch.cat(parts)
        return None if failed or not torch.isfinite(step).all() else step


def gauss_newton_step(
    network: PowerNetwork, inputs: torch.Tensor, target: torch.Tensor, damping: float
) -> torch.Tensor:
    """The step of all weights that brings the output to a target; zero if none helps.

    If single precision cannot factor the system, the damping is raised tenfold.
    """
    linearised = Linearised(network, inputs, target)
    while damping <= MOST_DAMPING:
        step: torch.Tensor | None = linearised.step(damping)
        if step is not None:
            return step
        damping *= 10.0
    return torch.zeros_like(network.vector())


@torch.no_grad()
def levenberg_marquardt(
    network: PowerNetwork, inputs: torch.Tensor, target: torch.Tensor, steps: int, damping: float
) -> float:
    """Move a network's output towards a target, in place; returns the damping.

    A step is accepted only if it reduces the mean square of the residual; the damping falls after
    an accepted step and rises after a refused one (Marquardt, 1963).
    """
    moved = True
    for _ in range(steps):
        if moved:
            weights, linearised = network.vector(), Linearised(network, inputs, target)
            least = torch.mean(linearised.residual**2)
        step, moved = linearised.step(damping), False
        if step is not None:
            network.load_vector(weights + step)
            # An error that is not finite refuses the step.
            moved = bool(torch.mean((target - network(inputs)) ** 2) < least)
        if moved:
            damping = max(LESS * damping, LEAST_DAMPING)
        else:
            damping = min(MORE * damping, MOST_DAMPING)
            network.load_vector(weights)
    return damping
