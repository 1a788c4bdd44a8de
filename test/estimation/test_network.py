import numpy as np
import pytest
import torch

from evpinn_ros.estimation.joint_step import JointProblem, joint_step
from evpinn_ros.estimation.network import PAPER_WIDTHS, PowerNetwork


def network(*widths, seed=0) -> PowerNetwork:
    """With biases that are not zero, so that their derivatives matter."""
    found = PowerNetwork(widths, seed=seed, dtype=torch.float64)
    generator = torch.Generator().manual_seed(seed + 1)
    weights = found.vector()
    shift = 0.3 * torch.randn(weights.shape, generator=generator, dtype=torch.float64)
    found.load_vector(weights + shift)
    return found


def test_the_paper_s_network_by_hand():
    """2 x 128 + 128, three times 128 x 128 + 128, 128 + 1: 384 + 3 x 16512 + 129 = 50049."""
    found = PowerNetwork(PAPER_WIDTHS, seed=0, dtype=torch.float32)
    assert PAPER_WIDTHS == (2, 128, 128, 128, 128, 1)
    assert found.vector().shape == (384 + 3 * 16_512 + 129,) == (50_049,)
    assert sum(weight.numel() for weight in found.parameters()) == 50_049


def test_the_output_by_hand():
    found = PowerNetwork((2, 1, 1), seed=0, dtype=torch.float64)
    found.load_vector(torch.tensor([1.0, -2.0, 0.5, 3.0, 0.25], dtype=torch.float64))
    inputs = torch.tensor([[0.3, 0.1], [0.0, 0.0]], dtype=torch.float64)
    # tanh(0.3 - 0.2 + 0.5) * 3 + 0.25 and tanh(0.5) * 3 + 0.25
    expected = [3 * np.tanh(0.6) + 0.25, 3 * np.tanh(0.5) + 0.25]
    assert found(inputs).tolist() == pytest.approx(expected)


def test_seeds_repeat_and_differ_and_leave_the_global_generator_alone():
    torch.manual_seed(3)
    before = torch.get_rng_state()
    one, same, other = (
        PowerNetwork(PAPER_WIDTHS, seed=seed, dtype=torch.float32).vector() for seed in (5, 5, 6)
    )
    assert torch.equal(one, same) and not torch.equal(one, other)
    # torch.nn.Linear draws weights of its own first; they do not count.
    assert torch.get_rng_state().shape == before.shape


def test_weights_start_by_glorot_s_rule():
    layer = PowerNetwork(PAPER_WIDTHS, seed=0, dtype=torch.float32).layers[1]
    # Variance 2 / (128 + 128); of 16384 draws, to 4 sigma (2 / sqrt(2 * 16384) each).
    assert float(layer.weight.detach().std()) == pytest.approx((2 / 256) ** 0.5, rel=0.023)
    assert not layer.bias.any()


@pytest.mark.parametrize("widths", [(3, 16, 16, 1), (2, 5, 1), (2, 8, 7, 6, 5, 1)])
def test_the_jacobian_is_autograd_s(widths):
    found = network(*widths)
    inputs = torch.randn(9, widths[0], generator=torch.Generator().manual_seed(7)).double()
    output, jacobian = found.jacobian(inputs)
    torch.testing.assert_close(output, found(inputs), rtol=0, atol=1e-14)
    for row, one in zip(jacobian, inputs, strict=True):
        gradients = torch.autograd.grad(found(one[None])[0], list(found.parameters()))
        expected = torch.cat([gradient.flatten() for gradient in gradients])
        torch.testing.assert_close(row, expected, rtol=1e-10, atol=1e-12)


def test_a_vector_of_weights_goes_there_and_back():
    found, other = network(3, 4, 1, seed=1), network(3, 4, 1, seed=2)
    other.load_vector(found.vector())
    assert torch.equal(found.vector(), other.vector())
    taken = found.vector()
    taken.zero_()
    assert found.vector().any()


def problem(rng, n=40, k=3, **others) -> JointProblem:
    factor = rng.standard_normal((k, k))
    values = {
        "inputs": rng.standard_normal((n, 2)),
        "residual": 0.5 * rng.standard_normal(n),
        "gradient": rng.standard_normal((n, k)),
        "prior_precision": factor @ factor.T + np.eye(k),
        "weight": 0.2,
        "physics_loss": 0.1,
        "ridge": 0.7,
    }
    return JointProblem(**{**values, **others})


def dense(found: PowerNetwork, start: np.ndarray, of: JointProblem) -> np.ndarray:
    """All of the loss as one least-squares problem in (dw, dx): the rows written out."""
    output, jacobian = (t.numpy() for t in found.jacobian(torch.from_numpy(of.inputs)))
    weights = found.vector().numpy()
    size, k = weights.size, of.gradient.shape[1]
    rest = of.residual - output
    huber = np.minimum(1.0, 2.0 / np.maximum(np.abs(rest), 1e-300))
    root = np.sqrt(of.weight * huber)[:, None]
    prior = np.linalg.cholesky(of.prior_precision).T
    physics = np.sqrt(of.physics_loss)
    rows = np.block(
        [
            [root * jacobian, root * of.gradient],
            [physics * root * jacobian, np.zeros((len(rest), k))],
            [np.zeros((k, size)), prior],
            [np.sqrt(of.ridge) * np.eye(size), np.zeros((size, k))],
        ]
    )
    right = np.concatenate(
        [
            root[:, 0] * rest,
            -physics * root[:, 0] * output,
            np.zeros(k),
            np.sqrt(of.ridge) * (start - weights),
        ]
    )
    return np.linalg.lstsq(rows, right, rcond=None)[0]


@pytest.mark.parametrize("scale", [0.5, 5.0])  # without and with residuals beyond Huber's limit
@pytest.mark.parametrize("seed", range(4))
def test_a_joint_step_solves_the_whole_problem(seed, scale):
    rng = np.random.default_rng(seed)
    found, start = network(2, 6, 5, 1, seed=seed), network(2, 6, 5, 1, seed=seed + 50)
    of = problem(rng, residual=scale * rng.standard_normal(40))
    step = joint_step(found, start.vector(), of)
    solved = dense(found, start.vector().numpy(), of)
    size = found.vector().numel()
    change = step.weights.numpy() - found.vector().numpy()
    np.testing.assert_allclose(change, solved[:size], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(step.parameter_change, solved[size:], rtol=1e-8, atol=1e-8)


def test_what_physics_can_explain_teaches_the_network_nothing():
    """Residuals that other parameters explain, with a prior that leaves them free."""
    rng = np.random.default_rng(0)
    gradient = rng.standard_normal((40, 3))
    of = problem(
        rng,
        gradient=gradient,
        residual=gradient @ np.array([0.3, -0.2, 0.1]),
        prior_precision=1e-9 * np.eye(3),
    )
    found = network(2, 6, 1)
    found.load_vector(0.0 * found.vector())
    step = joint_step(found, found.vector(), of)
    assert float(step.weights.abs().max()) < 1e-8
    np.testing.assert_allclose(step.parameter_change, [0.3, -0.2, 0.1], atol=1e-8)


def test_the_larger_the_physics_loss_the_less_the_network_says():
    """The output after the step, to first order, against the residual it should explain."""
    found = network(2, 6, 1)
    said = []
    for physics_loss in (0.0, 0.1, 1.0, 1e6):
        rng = np.random.default_rng(1)
        of = problem(rng, residual=np.ones(40), physics_loss=physics_loss, ridge=1e-3)
        output, jacobian = (t.numpy() for t in found.jacobian(torch.from_numpy(of.inputs)))
        change = joint_step(found, found.vector(), of).weights - found.vector()
        said.append(float(np.sqrt(np.mean((output + jacobian @ change.numpy()) ** 2))))
    assert said == sorted(said, reverse=True) and said[-1] < 0.01 < said[0]
