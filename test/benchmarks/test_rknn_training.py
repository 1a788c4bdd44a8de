import numpy as np
import pytest

torch = pytest.importorskip("torch")

from benchmarks.rknn_training import (  # noqa: E402
    RknnModule,
    energy_step,
    loss,
    main,
    synthetic_steps,
    train,
)
from evpinn_ros.energy.rknn import load_rknn  # noqa: E402

pytestmark = pytest.mark.torch


def test_synthetic_steps_have_their_simpson_integral():
    steps = synthetic_steps(np.random.default_rng(1), traces=16)
    simpson = steps.dt / 6 * (steps.power + 4 * steps.power_mid + steps.power_next)
    scale = steps.dt * (1e3 + steps.power.abs() + steps.power_next.abs())
    assert ((simpson - steps.energy).abs() <= 1e-9 * scale).all()


def test_synthetic_steps_cover_the_range():
    steps = synthetic_steps(np.random.default_rng(1))
    assert steps.power.min() < -1e5 and steps.power.max() > 2e5
    assert ((steps.power.abs() > 200) & (steps.power.abs() < 2000)).double().mean() > 0.05
    assert steps.dt.min() < 0.02 and steps.dt.max() > 1.0


def test_training_is_repeatable_and_learns():
    unseen = synthetic_steps(np.random.default_rng(5), traces=16)
    first, second = (train(seed=3, epochs=5, traces=16) for _ in range(2))
    for name, weights in first.weights().items():
        assert (weights == second.weights()[name]).all()
    assert loss(first, unseen).item() < 1e-5 < loss(RknnModule(), unseen).item()


def test_module_and_numpy_agree(tmp_path, monkeypatch):
    module = train(seed=4, epochs=2, traces=8)
    monkeypatch.setattr("benchmarks.rknn_training.train", lambda: module)
    path = tmp_path / "weights.npz"
    assert main([str(path)]) == 0
    steps = synthetic_steps(np.random.default_rng(6), traces=4)
    expected = energy_step(module(steps), steps.dt).detach().numpy()
    inside = (steps.power.abs() < 5e5) & (steps.power_next.abs() < 5e5)
    power, middle, power_next, dt, _ = (part.numpy() for part in steps)
    given = load_rknn(path).step(power, power_next, dt, middle)
    assert given[inside.numpy()] == pytest.approx(expected[inside.numpy()], rel=1e-9, abs=1e-6)


def test_usage(capsys):
    assert main([]) == 2
    assert "usage" in capsys.readouterr().err
