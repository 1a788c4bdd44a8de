"""Gauss-Newton in the space of residuals, for networks with far more weights than samples.

The damped step dw = (J^T J + d I)^-1 J^T r of the weights equals

    dw = J^T (J J^T + d I)^-1 r

(push-through identity), a system of one unknown per sample instead of one per weight: 1000 in
place of 50 049. For a fully connected network J need never be formed. With the activations A_l
that enter layer l and the derivatives D_l of the output by what leaves it,

    J J^T = sum over l of (A_l A_l^T + 1) o (D_l D_l^T)      (o elementwise)

and J^T a is one more product per layer (dual Gauss-Newton: Jnini et al., arXiv 2505.21404).
"""

from __future__ import annotations

import torch

from evpinn_ros.estimation.network import PowerNetwork

LEAST_DAMPING = 1e-3  # of `levenberg_marquardt`, which keeps what the samples do not determine
LESS, MORE = 1.0 / 3.0, 5.0  # factors of the damping after a step that helped, and any other
MOST_DAMPING = 1.0  # of the mean diagonal; beyond it a step is no more than a gradient's


def gram(activations: list[torch.Tensor], derivatives: list[torch.Tensor]) -> torch.Tensor:
    """J J^T, shape (n, n), from `PowerNetwork.sweep`."""
    samples = len(activations[0])
    total = activations[0].new_zeros(samples, samples)
    for entering, derivative in zip(activations, derivatives, strict=True):
        total += (entering @ entering.T + 1.0) * (derivative @ derivative.T)
    return total


@torch.no_grad()
def gauss_newton_step(
    network: PowerNetwork, inputs: torch.Tensor, target: torch.Tensor, damping: float
) -> torch.Tensor:
    """The step of all weights, shape (weights,), that brings the output to a target.

    Args:
        network: at its present weights; it is not changed.
        inputs: shape (n, inputs).
        target: wanted output, shape (n,).
        damping: d over the mean of the diagonal of J J^T. Where single precision cannot factor
            the system it is raised tenfold.

    Returns:
        The step, in the order of `PowerNetwork.vector`; zero where no damping helps.
    """
    output, activations, derivatives = network.sweep(inputs)
    system = gram(activations, derivatives)
    diagonal = system.diagonal()
    mean = float(diagonal.mean())
    added = 0.0
    while damping <= MOST_DAMPING:
        diagonal += (damping - added) * mean
        added = damping
        factor, failed = torch.linalg.cholesky_ex(system)
        if not failed:
            dual = torch.cholesky_solve((target - output)[:, None], factor)
            step = _weights(activations, derivatives, dual)
            return step if torch.isfinite(step).all() else torch.zeros_like(step)
        damping *= 10.0
    return torch.zeros_like(network.vector())


@torch.no_grad()
def levenberg_marquardt(
    network: PowerNetwork,
    inputs: torch.Tensor,
    target: torch.Tensor,
    steps: int,
    damping: float,
) -> float:
    """Bring the output of a network nearer to a target, in a fixed number of trials.

    A step is taken only when it lessens the mean square of the residual; the damping falls after
    such a step and rises after any other (Marquardt, 1963).

    Args:
        network: changed in place, never for the worse.
        inputs: shape (n, inputs).
        target: wanted output, shape (n,).
        steps: solutions of the system of n unknowns.
        damping: to begin with, over the mean of the diagonal of J J^T.

    Returns:
        The damping to go on with.
    """
    moved = True
    for _ in range(steps):
        if moved:
            weights = network.vector()
            output, activations, derivatives = network.sweep(inputs)
            least = torch.mean((target - output) ** 2)
            system = gram(activations, derivatives)
        damped = system.clone()
        damped.diagonal().add_(damping * system.diagonal().mean())
        factor, failed = torch.linalg.cholesky_ex(damped)
        dual = torch.cholesky_solve((target - output)[:, None], factor)
        network.load_vector(weights + _weights(activations, derivatives, dual))
        error = torch.mean((target - network(inputs)) ** 2)
        moved = bool(not failed and error < least)  # an error that is not finite is no better
        if moved:
            damping = max(LESS * damping, LEAST_DAMPING)
        else:
            damping = min(MORE * damping, MOST_DAMPING)
            network.load_vector(weights)
    return damping


def _weights(
    activations: list[torch.Tensor], derivatives: list[torch.Tensor], dual: torch.Tensor
) -> torch.Tensor:
    """J^T a, shape (weights,), for a of shape (n, 1)."""
    parts: list[torch.Tensor] = []
    for entering, derivative in zip(activations, derivatives, strict=True):
        weighted = derivative * dual
        parts += [(weighted.T @ entering).flatten(), weighted.sum(0)]
    return torch.cat(parts)
