import numpy as np
import pytest
import torch

from evpinn_ros.extras.paper.network import PAPER_WIDTHS, PowerNetwork


def test_the_paper_s_network_by_hand():
    """2 x 128 + 128, three times 128 x 128 + 128, 128 + 1: 384 + 3 x 16512 + 129 = 50049."""
    network = PowerNetwork(PAPER_WIDTHS, seed=0, dtype=torch.float32)
    assert PAPER_WIDTHS == (2, 128, 128, 128, 128, 1)
    assert network.vector().shape == (384 + 3 * 16_512 + 129,) == (50_049,)
    assert sum(weight.numel() for weight in network.parameters()) == 50_049


def test_the_output_by_hand():
    network = PowerNetwork((2, 1, 1), seed=0, dtype=torch.float64)
    network.load_vector(torch.tensor([1.0, -2.0, 0.5, 3.0, 0.25], dtype=torch.float64))
    inputs = torch.tensor([[0.3, 0.1], [0.0, 0.0]], dtype=torch.float64)
    # tanh(0.3 - 0.2 + 0.5) * 3 + 0.25 and tanh(0.5) * 3 + 0.25
    expected = [3 * np.tanh(0.6) + 0.25, 3 * np.tanh(0.5) + 0.25]
    assert network(inputs).tolist() == pytest.approx(expected)
