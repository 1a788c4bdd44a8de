"""One exact step of training network and physics together (eq. 22, parameters eliminated).

With the network as a correction of the physics, P_pred = P_physics + N, the paper's physics loss
lambda |P_physics - P_pred|^2 is lambda N^2: the network pays for all it says that the physics does
not. Around the present weights w the loss is a linear least-squares problem in the change dw of
the weights and the change dx of the physics parameters,

    sum_i q_i (r_i - H_i dx - y_i - J_i dw)^2 + lambda sum_i q_i (y_i + J_i dw)^2
    + dx' S^-1 dx + rho |w + dw - w0|^2,

with r the residuals of the physics, H its gradient, y and J the network's output and Jacobian.
dx is eliminated exactly (variable projection, Golub and Pereyra 1973): data that physics can
explain by other parameters, within their prior S, teaches the network nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evpinn_ros.estimation.window_network import WindowNetwork

OUTLIER = 2.0  # sigmas beyond which a residual's weight falls (Huber)


class JointProblem(NamedTuple):
    """What one step is solved on; n samples, k physics parameters.

    Attributes:
        inputs: network inputs, shape (n, d).
        residual: of the physics, in sigmas, shape (n,).
        gradient: of the physics by its parameters, in sigmas, shape (n, k).
        prior_precision: inverse of the prior covariance S, shape (k, k).
        weight: what one sample counts, of 1.
        physics_loss: lambda of eq. 22.
        ridge: rho, pull of the weights to their start.
    """

    inputs: np.ndarray
    residual: np.ndarray
    gradient: np.ndarray
    prior_precision: np.ndarray
    weight: float
    physics_loss: float
    ridge: float


class JointStep(NamedTuple):
    """Result: new weights of the network, shape (w,), and change of the parameters, shape (k,)."""

    weights: np.ndarray
    parameter_change: np.ndarray


def joint_step(network: WindowNetwork, start: np.ndarray, problem: JointProblem) -> JointStep:
    """Solve one step; `start`, shape (w,), is what the ridge pulls the weights to."""
    output, jacobian = network.jacobian(problem.inputs)
    rest = problem.residual - output
    huber = 1.0 / np.maximum(1.0, np.abs(rest) / OUTLIER)
    root = np.sqrt(problem.weight * huber)[:, None]
    hidden = problem.gradient * root
    physics = np.linalg.inv(problem.prior_precision + hidden.T @ hidden)

    def project(columns: np.ndarray) -> np.ndarray:
        """What the physics, re-fitted within its prior, leaves of weighted columns."""
        left: np.ndarray = columns - hidden @ (physics @ (hidden.T @ columns))
        return left

    weighted = jacobian * root
    size = len(network.weights)
    # weighted' project(weighted), without a matrix of all samples by all weights in between.
    shared = hidden.T @ weighted
    normal = (1.0 + problem.physics_loss) * (weighted.T @ weighted) - shared.T @ physics @ shared
    normal[np.diag_indices(size)] += problem.ridge
    slope = weighted.T @ project(rest[:, None] * root)
    slope -= problem.physics_loss * (weighted.T @ (output[:, None] * root))
    slope[:, 0] -= problem.ridge * (network.weights - start)
    change = np.linalg.solve(normal, slope)[:, 0]
    left = (rest - jacobian @ change)[:, None] * root
    parameter_change = physics @ (hidden.T @ left)
    return JointStep(network.weights + change, parameter_change[:, 0])
