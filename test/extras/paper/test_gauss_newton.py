"""The step in the space of residuals is the dense least-squares step."""

from itertools import pairwise

import numpy as np
import pytest
import torch

from evpinn_ros.extras.paper.gauss_newton import (
    LEAST_DAMPING,
    MOST_DAMPING,
    gauss_newton_step,
    levenberg_marquardt,
)
from evpinn_ros.extras.paper.network import PAPER_WIDTHS, PowerNetwork, spread_over_time

WIDTHS = (2, 6, 5, 1)


def drawn(seed, samples):
    generator = torch.Generator().manual_seed(seed)
    network = PowerNetwork(WIDTHS, seed=seed, dtype=torch.float64)
    inputs = torch.randn(samples, 2, generator=generator, dtype=torch.float64)
    target = torch.randn(samples, generator=generator, dtype=torch.float64)
    return network, inputs, target


def jacobian_of(network, inputs):
    """Output and Jacobian, a row of gradients for each sample."""
    output = network(inputs)
    weights = list(network.parameters())
    rows = [torch.autograd.grad(value, weights, retain_graph=True) for value in output]
    jacobian = torch.stack([torch.cat([part.ravel() for part in row]) for row in rows])
    return output.detach(), jacobian


@pytest.mark.parametrize("samples", [20, 200])  # fewer and more than the 59 weights
def test_step_is_the_dense_least_squares_solution(samples):
    """min |J dw - r|^2 + d |dw|^2 solved as an ordinary least-squares problem of stacked rows."""
    network, inputs, target = drawn(4, samples)
    output, jacobian = jacobian_of(network, inputs)
    damping = 1e-3 * float((jacobian**2).sum(1).mean())
    weights = jacobian.shape[1]
    rows = torch.cat((jacobian, damping**0.5 * torch.eye(weights, dtype=torch.float64)))
    right = torch.cat((target - output.detach(), torch.zeros(weights, dtype=torch.float64)))
    dense = torch.linalg.lstsq(rows, right[:, None]).solution[:, 0]
    step = gauss_newton_step(network, inputs, target, 1e-3)
    assert torch.allclose(step, dense, rtol=1e-7, atol=1e-10)


def test_marquardt_never_makes_it_worse_and_comes_near_where_adam_does_not():
    network = PowerNetwork(PAPER_WIDTHS, seed=2, dtype=torch.float32)
    spread_over_time(network, torch.Generator().manual_seed(2), -1.0, 0.0, 0.1)
    inputs = torch.stack((torch.rand(200), torch.linspace(-1.0, 0.0, 200)), dim=1)
    target = torch.sin(12.0 * inputs[:, 1]) * inputs[:, 0]
    errors, damping = [], 1e-2
    for _ in range(12):
        damping = levenberg_marquardt(network, inputs, target, 4, damping)
        errors.append(float(torch.mean((network(inputs) - target).detach() ** 2)))
        assert LEAST_DAMPING <= damping <= MOST_DAMPING
    assert all(after <= before for before, after in pairwise(errors))
    assert errors[-1] < 0.01 * float(torch.var(target))


def test_the_output_by_hand():
    network = PowerNetwork((2, 1, 1), seed=0, dtype=torch.float64)
    network.load_vector(torch.tensor([1.0, -2.0, 0.5, 3.0, 0.25], dtype=torch.float64))
    inputs = torch.tensor([[0.3, 0.1], [0.0, 0.0]], dtype=torch.float64)
    # tanh(0.3 - 0.2 + 0.5) * 3 + 0.25 and tanh(0.5) * 3 + 0.25
    expected = [3 * np.tanh(0.6) + 0.25, 3 * np.tanh(0.5) + 0.25]
    assert network(inputs).tolist() == pytest.approx(expected)
