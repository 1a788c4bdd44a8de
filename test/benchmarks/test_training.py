"""The race to a loss: everybody on the same problem, the clock stopped at the same loss."""

from collections.abc import Callable
import math

import pytest

from benchmarks.deepxde_peer import DeepXdeTraining, deepxde_version
from benchmarks.training import Contender, Training, bench_training, time_to_loss
from evpinn_ros.reproduction.drive_log import DriveLog
from evpinn_ros.reproduction.problem import Problem, random_split
from evpinn_ros.vehicle.files import Vehicle
from test.reproduction.conftest import make_log, vehicle  # noqa: F401

pytestmark = pytest.mark.torch


class Halving:
    """A training whose validation loss halves with every epoch."""

    def __init__(self) -> None:
        self.loss = 1.0

    def train(self, epochs: int, after_epoch: Callable[[], bool]) -> None:
        for _ in range(epochs):
            self.loss /= 2
            if after_epoch():
                return

    def validation_loss(self) -> float:
        return self.loss


def timed(stop: float, every: int = 1, epochs: int = 100):
    contender = Contender("halving", Halving, every)
    return time_to_loss(contender, epochs, stop, lambda *_: None)


def test_clock_stops_at_the_loss() -> None:
    found = timed(stop=0.1)
    assert (found.epochs, found.best, found.best_epoch, found.reached) == (4, 1 / 16, 4, True)
    assert found.seconds > 0


def test_loss_is_looked_at_every_so_many_epochs() -> None:
    assert timed(stop=0.1, every=10).epochs == 10


def test_without_a_stop_every_epoch_is_run() -> None:
    found = timed(stop=-math.inf, every=7, epochs=20)
    assert (found.epochs, found.reached, found.best) == (20, False, 2.0**-20)


@pytest.mark.nightly
def test_everybody_races_to_the_loss_of_adam(
    make_log: Callable[..., DriveLog],  # noqa: F811
    vehicle: Vehicle,  # noqa: F811
) -> None:
    titles: set[str] = set()
    found = list(bench_training(make_log(), vehicle, 30, 0, lambda title, *_: titles.add(title)))
    published = found[0]
    assert published.title == "Adam as published" and published.epochs == 30
    ours = next(one for one in found if "ours" in one.title)
    assert ours.reached and ours.best <= published.best
    same = next(one for one in found if "L-BFGS" in one.title)  # Adam itself, so early on
    assert same.best_epoch == published.best_epoch
    assert titles == {one.title for one in found}
    assert len(found) == 4 + (deepxde_version() is not None)


@pytest.mark.skipif(deepxde_version() is None, reason="DeepXDE is optional")
def test_deepxde_solves_the_same_problem(
    make_log: Callable[..., DriveLog],  # noqa: F811
    vehicle: Vehicle,  # noqa: F811
) -> None:
    """Its loss falls on our validation data, and its parameters move."""
    log = make_log()
    training: Training = DeepXdeTraining(
        Problem(log, vehicle, random_split(len(log.time), 0)), seed=0
    )
    before = training.validation_loss()
    training.train(40, lambda: False)
    assert training.validation_loss() < 0.5 * before
    assert all(float(z.detach()) != 0.0 for z in training.log_scale)
