"""A recorded bag says what the run that made it knew."""

import time

import numpy as np
import pytest

from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.logs.sources import open_source
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.run import ReplayOptions, replay
from evpinn_ros.replays.scoring import drive_scores
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.output import write
from evpinn_ros.replays.simulation.simulate import simulate
from evpinn_ros.report.figure import recorded_drive

pytestmark = pytest.mark.slow


def test_the_bag_of_a_replay_gives_its_series_back(vehicle, tmp_path):
    write(simulate(DriveKind.URBAN, vehicle, 60.0, seed=11), tmp_path / "drive")
    source = open_source(tmp_path / "drive", vehicle)
    chain = Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter))
    names = {"vehicle": vehicle.key, "mode": "hybrid"}
    with BagWriter(tmp_path / "bag") as writer:
        made = replay(source, chain, ReplayOptions(), writer=writer, **names).drive
    recorded = recorded_drive(tmp_path / "bag")
    assert recorded.duration == pytest.approx(made.duration)
    for series in ("smoothed", "newest"):
        for ours, theirs in zip(getattr(recorded, series), getattr(made, series), strict=True):
            assert np.array_equal(ours, theirs)
    assert recorded.final is not None and made.final is not None
    assert recorded.final.parameters["mass"].value == made.final.parameters["mass"].value
    for name, rows in made.combinations.items():
        assert np.array_equal(recorded.combinations[name], rows)
    parts = {name: kwh for name, (kwh, _) in recorded.breakdown.items() if name != "regained"}
    assert parts.pop("measured") == pytest.approx(sum(parts.values()))
    assert all(np.isfinite(sigma) for _, sigma in recorded.breakdown.values())
    scores = drive_scores(recorded, warm_up=30.0)
    assert all(value is not None and np.isfinite(value) for value in scores["energy"].values())
    assert scores["power"]["rmse_w"] == pytest.approx(
        drive_scores(made, warm_up=30.0)["power"]["rmse_w"], rel=1e-4
    )
