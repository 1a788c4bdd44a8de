"""One car over its drives: order, going on, and what may go wrong."""

from dataclasses import replace
import json
import os
from pathlib import Path
import shutil
import time

import numpy as np
import pytest

from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.extras.fleet import car as car_module
from evpinn_ros.extras.fleet.car import RESULT_FILE, STATE_FILE, CarTask, learn_car
from evpinn_ros.extras.fleet.manifest import CarDrives
from evpinn_ros.logs.sources import open_source
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.run import ReplayOptions, replay


def result(task):
    return json.loads((task.folder / RESULT_FILE).read_text())


def names(task):
    return [row["path"].rsplit("/", 1)[-1] for row in result(task)["drives"]]


@pytest.fixture(scope="module")
def learned(recorded, leaf, tmp_path_factory):
    """Task of the three drives, learned in two runs; a test may write in a copy of its folder."""
    folder = tmp_path_factory.mktemp("learned")
    for names in ("ca", "bac"):
        drives = tuple(recorded / name for name in names)
        task = CarTask(CarDrives("car", leaf, drives), folder / "out", folder / "stop")
        done = learn_car(task)
    assert (done.learned, done.kept, done.failed) == (1, 2, 0)
    return task


@pytest.fixture
def instant(recorded, leaf, monkeypatch):
    """Replays cost nothing and teach nothing; every drive has the scores of the first."""
    chain = Chain(leaf, EstimatorSettings(), InlineWorker(time.perf_counter))
    source = open_source(recorded / "c", leaf)
    done = replay(source, chain, ReplayOptions(duration=1.0), vehicle=leaf.key, mode="hybrid")
    monkeypatch.setattr(car_module, "replay", lambda *_, **__: done)


def test_drives_are_learned_in_order_of_time(learned):
    assert names(learned) == ["c", "a", "b"]
    shares = [row["mass_prior_share"] for row in result(learned)["drives"]]
    assert shares[0] > shares[1] > shares[2], "what was learned is carried on"


def test_what_is_done_is_not_done_again(learned, monkeypatch):
    before = (learned.folder / RESULT_FILE).stat().st_mtime_ns
    monkeypatch.setattr(car_module, "replay", None)
    monkeypatch.setattr(car_module, "open_source", None)
    assert learn_car(learned).kept == 3
    assert (learned.folder / RESULT_FILE).stat().st_mtime_ns == before


@pytest.mark.usefixtures("instant")
@pytest.mark.parametrize("change", ["earlier drive", "drive", "vehicle", "state", "result"])
def test_what_changed_is_learned_anew(task, drives, leaf, change):
    car_task = task(drives / "a", drives / "b")
    learn_car(car_task)
    again = car_task
    if change == "earlier drive":
        again = task(drives / "a", drives / "b", drives / "c")
    elif change == "drive":
        os.utime(next((drives / "a").glob("*.mcap")), (0, 0))
    elif change == "vehicle":
        again = task(drives / "a", drives / "b", vehicle=replace(leaf, frontal_area=2.5))
    elif change == "state":
        (car_task.folder / STATE_FILE).write_text("{}")
        os.utime(next((drives / "b").glob("*.mcap")), (0, 0))
    else:
        (car_task.folder / RESULT_FILE).write_text('{"basis": ')
    assert learn_car(again).kept == 0
    assert len(result(again)["drives"]) == len(again.drives.drives)


def test_a_bad_drive_costs_itself_alone(learned, tmp_path):
    folder = Path(shutil.copytree(learned.folder, tmp_path / "out"))
    garbage, empty, halfway, book, columns = (
        tmp_path / name
        for name in ("no.mcap", "no.csv", "halfway.csv", "damaged.xlsx", "damaged.parquet")
    )
    garbage.write_bytes(b"no bag")
    empty.write_text("")
    # It opens, but its speed is no number.
    halfway.write_text("t_s,speed_mps,power_w\n" + "1800000000,nan,5\n" * 3)
    book.write_bytes(b"PK\x03\x04" + bytes(range(256)) * 8)
    columns.write_bytes(b"PAR1" + bytes(range(256)) * 8 + b"PAR1")

    def learn(*bad):
        drives = CarDrives("car", learned.drives.vehicle, (*learned.drives.drives, *bad))
        car_task = CarTask(drives, folder, learned.stop)
        return learn_car(car_task), result(car_task)

    bad = (halfway, garbage, empty, tmp_path / "gone", book, columns)
    done, outcome = learn(*bad)
    assert (done.failed, done.kept) == (len(bad), 3)
    rows = [*outcome["unreadable"], *outcome["drives"]]
    assert len([row for row in rows if row["problem"]]) == len(bad)
    assert outcome["precision"] == result(learned)["precision"]
    done, _ = learn(*bad[:2])
    assert done.learned == 0, "a bad drive does not keep the others from being done"


def test_a_drive_without_battery_is_no_evidence(task, drives):
    path = drives / "speed.csv"
    rows = [f"{i / 10},{5 + np.sin(i / 20)}," for i in range(150)]
    path.write_text("t_s,speed_mps,power_w\n" + "\n".join(rows))
    car_task = task(path)
    assert learn_car(car_task).failed == 0
    assert not np.any(result(car_task)["precision"])
