"""The network of the window against torch's, which has the same weights in the same order."""

from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest
import torch

from evpinn_ros.estimation.hybrid import WIDTHS
from evpinn_ros.estimation.network import PowerNetwork
from evpinn_ros.estimation.window_network import WindowNetwork

ROOT = Path(__file__).resolve().parents[2]


def pair(widths, seed=0) -> tuple[WindowNetwork, PowerNetwork]:
    """One function twice; biases are not zero, so that their derivatives matter."""
    peer = PowerNetwork(widths, seed=seed, dtype=torch.float64)
    weights = np.random.default_rng(seed).normal(0.0, 0.5, len(peer.vector()))
    peer.load_vector(torch.from_numpy(weights))
    return WindowNetwork(widths, weights), peer


@pytest.mark.parametrize("widths", [(3, 16, 16, 1), (2, 5, 1), (2, 8, 7, 6, 5, 1)])
def test_output_and_jacobian_are_autograd_s(widths):
    found, peer = pair(widths)
    inputs = np.random.default_rng(7).standard_normal((9, widths[0]))
    output, jacobian = found.jacobian(inputs)
    assert jacobian.shape == (9, len(found.weights))
    for said, row, one in zip(output, jacobian, inputs, strict=True):
        expected = peer(torch.from_numpy(one[None]))[0]
        assert [said, found.at(one)] == pytest.approx([expected.item()] * 2, abs=1e-14)
        gradients = torch.autograd.grad(expected, list(peer.parameters()))
        np.testing.assert_allclose(row, np.concatenate([g.flatten() for g in gradients]), 1e-10)


def test_it_says_nothing_at_first_and_can_learn_to():
    found = WindowNetwork.silent(WIDTHS, seed=3)
    inputs = np.array([[1.0, -1.0, 0.5]])
    output, jacobian = found.jacobian(inputs)
    assert output == found.at(inputs[0]) == 0.0
    assert np.count_nonzero(jacobian) == WIDTHS[-2] + 1  # of the last layer, which lets others in
    np.testing.assert_array_equal(WindowNetwork.silent(WIDTHS, seed=3).weights, found.weights)
    assert (WindowNetwork.silent(WIDTHS, seed=4).weights != found.weights).any()


@pytest.mark.parametrize("weights", [[0.0] * 3, [[0.0] * 13], [0.0] * 14])
def test_weights_of_another_shape_are_refused(weights):
    with pytest.raises(ValueError, match="another shape"):
        WindowNetwork((2, 3, 1), weights)


def test_what_is_done_to_its_weights_elsewhere_does_not_reach_it():
    weights = np.ones(13)
    found = WindowNetwork((2, 3, 1), weights)
    before = found.at(np.ones(2))
    weights[:] = 0.0
    assert found.at(np.ones(2)) == before


def test_learning_needs_neither_torch_nor_scipy():
    """They take three quarters of all the time to load."""
    code = (
        "import sys, time\nfrom pathlib import Path\n"
        "sys.modules['torch'] = sys.modules['scipy'] = None\n"
        "from evpinn_ros.estimation.estimator import EstimatorSettings\n"
        "from evpinn_ros.estimation.worker import InlineWorker\n"
        "from evpinn_ros.one_thread import one_thread\n"
        "from evpinn_ros.replay.chain import Chain\n"
        "from evpinn_ros.replay.sources import open_source\n"
        "from evpinn_ros.vehicle.files import load_vehicle\n"
        "one_thread()\n"
        "vehicle = load_vehicle('tesla_model_3_lr')\n"
        "chain = Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter))\n"
        "readings = open_source(Path('bags/urban'), vehicle, None).readings()\n"
        "for reading, _ in zip(readings, range(1000)):\n"
        "    list(chain.push(reading))\n"
        "assert chain.estimator.status().updates > 10\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
