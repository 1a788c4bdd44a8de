import numpy as np
import pytest

from evpinn_ros.estimation.joint_step import JointProblem, joint_step
from evpinn_ros.estimation.window_network import WindowNetwork


def network(*widths, seed=0) -> WindowNetwork:
    """With biases and a last layer that are not zero."""
    start = WindowNetwork.silent(widths, seed)
    shift = 0.3 * np.random.default_rng(seed + 1).standard_normal(start.weights.shape)
    return start.with_weights(start.weights + shift)


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


def dense(found: WindowNetwork, start: np.ndarray, of: JointProblem) -> np.ndarray:
    """All of the loss as one least-squares problem in (dw, dx): the rows written out."""
    output, jacobian = found.jacobian(of.inputs)
    weights = found.weights
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
    step = joint_step(found, start.weights, of)
    solved = dense(found, start.weights, of)
    size = len(found.weights)
    change = step.weights - found.weights
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
    found = found.with_weights(0.0 * found.weights)
    step = joint_step(found, found.weights, of)
    assert np.abs(step.weights).max() < 1e-8
    np.testing.assert_allclose(step.parameter_change, [0.3, -0.2, 0.1], atol=1e-8)


def test_the_larger_the_physics_loss_the_less_the_network_says():
    """The output after the step, to first order, against the residual it should explain."""
    found = network(2, 6, 1)
    said = []
    for physics_loss in (0.0, 0.1, 1.0, 1e6):
        rng = np.random.default_rng(1)
        of = problem(rng, residual=np.ones(40), physics_loss=physics_loss, ridge=1e-3)
        output, jacobian = found.jacobian(of.inputs)
        change = joint_step(found, found.weights, of).weights - found.weights
        said.append(float(np.sqrt(np.mean((output + jacobian @ change) ** 2))))
    assert said == sorted(said, reverse=True) and said[-1] < 0.01 < said[0]
