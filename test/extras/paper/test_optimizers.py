"""Training: resumable to the same numbers, and how far each way comes in a few epochs."""

import numpy as np
import pytest
import torch

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.extras.paper.checkpoint import load_checkpoint, save_checkpoint
from evpinn_ros.extras.paper.optimizers import INPUTS, OPTIMIZERS
from evpinn_ros.extras.paper.problem import Problem, random_split
from evpinn_ros.extras.paper.scores import combinations
from evpinn_ros.extras.paper.settings import OptimizerName
from test.extras.paper.conftest import TRUE


@pytest.fixture(scope="module")
def begin(make_log, vehicle):
    log = make_log()

    def make(name, epochs):
        split = random_split(len(log.time), 0)
        problem = Problem(log, vehicle, split, inputs=INPUTS[name])
        return OPTIMIZERS[name](problem, epochs, seed=1)

    return make


@pytest.mark.parametrize("name", [OptimizerName.ADAM, OptimizerName.GAUSS_NEWTON])
def test_resumed_training_gives_the_same_numbers(name, begin, tmp_path):
    whole = begin(name, 12)
    whole.run_to(12)
    first = begin(name, 12)
    first.run_to(7)
    save_checkpoint(tmp_path / "a.npz", "same", first.state())
    second = begin(name, 12)
    second.load_state(load_checkpoint(tmp_path / "a.npz", "same"))
    second.run_to(12)
    assert second.rows == whole.rows
    assert torch.equal(second.network.vector(), whole.network.vector())


def test_ours_is_below_adam_after_as_many_epochs_and_finds_the_true_combinations(begin, vehicle):
    final = {}
    for name in (OptimizerName.ADAM, OptimizerName.GAUSS_NEWTON):
        training = begin(name, 40)
        training.run_to(40)
        final[name] = training.rows[-1].validation.total
    assert final[OptimizerName.GAUSS_NEWTON] < 0.2 * final[OptimizerName.ADAM]
    fitted = combinations(training.values, vehicle.frontal_area, RegenForm.RECOVERY)
    truth = combinations(TRUE, vehicle.frontal_area, RegenForm.RECOVERY)
    for name in ("mass_over_eta", "mu", "c_rr"):
        assert fitted[name] == pytest.approx(truth[name], rel=0.05)


def test_a_checkpoint_of_other_settings_is_none_and_a_broken_one_refused(tmp_path):
    path = tmp_path / "a.npz"
    assert load_checkpoint(path, "x") is None
    save_checkpoint(path, "x", {"weights": torch.arange(4.0)})
    assert load_checkpoint(path, "y") is None
    kept = load_checkpoint(path, "x")
    assert kept is not None and torch.equal(kept["weights"], torch.arange(4.0))

    def is_refused():
        with pytest.raises(InputError, match=r"a\.npz: the saved training .*delete it to train"):
            load_checkpoint(path, "x")

    np.savez(path, settings=np.array("x"), weights=np.array(["no number"]))
    is_refused()
    with path.open("wb") as file:
        np.save(file, np.arange(3))
    is_refused()
    path.write_bytes(path.read_bytes()[:10])
    is_refused()
