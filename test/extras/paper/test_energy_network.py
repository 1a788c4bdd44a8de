import numpy as np
import pytest
import torch

from evpinn_ros.extras.paper.checkpoint import load_checkpoint, save_checkpoint
from evpinn_ros.extras.paper.energy_network import MAX_GAP, EnergyTraining, step_data

EPOCHS = 60


def drive(samples=201):
    """Time, s, and a smooth power, W, with regeneration."""
    time = 0.1 * np.arange(samples)
    return time, 4e3 + 9e3 * np.sin(0.7 * time) + 5e3 * np.sin(2.3 * time)


def training(seed=3):
    return EnergyTraining(step_data(*drive()), seed=seed)


@pytest.fixture(scope="module")
def trained():
    run = training()
    run.run_to(EPOCHS)
    return run


def test_steps_across_gaps_and_beside_unknown_power_are_left_out():
    time, power = drive()
    power[10] = np.nan
    time[100:] += MAX_GAP
    data = step_data(time, power)
    assert len(data.dt) == 200 - 2 - 1
    assert data.dt.max() < 0.2
    assert data.energy == pytest.approx(np.cumsum(data.step_energy) - data.step_energy)


def test_losses_are_eq_30_over_the_mean_square_step():
    data = step_data(*drive())
    run = EnergyTraining(data, seed=1)
    for weights in run._networks.parameters():
        torch.nn.init.zeros_(weights)
    run.run_to(1)
    losses = run.losses[0]
    for train, validation in ((losses.rknn_training, losses.rknn_validation), losses[3:]):
        assert 0.8 * train + 0.2 * validation == pytest.approx(1.0, rel=1e-5)


def test_interrupted_training_gives_the_same_numbers(trained, tmp_path):
    first = training()
    first.run_to(25)
    save_checkpoint(tmp_path / "energy.npz", "same", first.state())
    resumed = training()
    saved = load_checkpoint(tmp_path / "energy.npz", "same")
    resumed.load_state(saved)
    assert resumed.epoch == 25
    resumed.run_to(EPOCHS)
    assert resumed.losses == trained.losses
    for ours, other in zip(resumed.integrate(*drive()), trained.integrate(*drive()), strict=True):
        assert (ours == other).all()
    again = training()
    again.load_state(saved)  # training did not write into what was saved
    again.run_to(EPOCHS)
    assert again.losses == trained.losses


def test_roll_out_follows_the_quadrature_and_stands_still_in_gaps(trained):
    time, power = drive()
    gap = 80
    time[gap:] += 10 * MAX_GAP
    data = step_data(time, power)
    total = data.step_energy.sum()
    for rolled in trained.integrate(time, power):
        assert rolled.shape == time.shape
        assert rolled[gap] == rolled[gap - 1]
        assert rolled[-1] == pytest.approx(total, rel=0.2)
