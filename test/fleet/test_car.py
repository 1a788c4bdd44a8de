"""One car over its drives: order, going on, and what may go wrong."""

from dataclasses import replace
import json
import os

import numpy as np
import pytest

from evpinn_ros.estimation.state_file import read_state
from evpinn_ros.fleet import car as car_module
from evpinn_ros.fleet.car import RESULT_FILE, STATE_FILE, StoppedError, learn_car


def result(task):
    return json.loads((task.folder / RESULT_FILE).read_text())


def names(task):
    return [row["path"].rsplit("/", 1)[-1] for row in result(task)["drives"]]


def test_drives_are_learned_in_order_of_time(task, drives):
    one = task(drives / "a", drives / "b", drives / "c")
    done = learn_car(one)
    assert (done.learned, done.kept, done.failed) == (3, 0, 0)
    assert names(one) == ["c", "a", "b"]
    shares = [row["mass_prior_share"] for row in result(one)["drives"]]
    assert shares[0] > shares[1] > shares[2], "what was learned is carried on"


def test_a_run_that_was_stopped_goes_on_to_the_same_numbers(task, drives):
    whole, parts = task(drives / "c", drives / "a"), task(drives / "c", folder="parts")
    learn_car(whole)
    learn_car(parts)
    parts = task(drives / "c", drives / "a", folder="parts")
    done = learn_car(parts)
    assert (done.learned, done.kept) == (1, 1)
    assert result(parts) == result(whole)
    assert read_state(parts.folder / STATE_FILE) == read_state(whole.folder / STATE_FILE)


def test_what_is_done_is_not_done_again(task, drives, monkeypatch):
    one = task(drives / "c")
    learn_car(one)
    before = (one.folder / RESULT_FILE).stat().st_mtime_ns
    monkeypatch.setattr(car_module, "replay", None)
    monkeypatch.setattr(car_module, "open_source", None)
    assert learn_car(one).kept == 1
    assert (one.folder / RESULT_FILE).stat().st_mtime_ns == before


@pytest.mark.parametrize("change", ["earlier drive", "drive", "vehicle", "state", "result"])
def test_what_changed_is_learned_anew(task, drives, leaf, change):
    one = task(drives / "a", drives / "b")
    learn_car(one)
    again = one
    if change == "earlier drive":
        again = task(drives / "a", drives / "b", drives / "c")
    elif change == "drive":
        os.utime(next((drives / "a").glob("*.mcap")), (0, 0))
    elif change == "vehicle":
        again = task(drives / "a", drives / "b", vehicle=replace(leaf, frontal_area=2.5))
    elif change == "state":
        (one.folder / STATE_FILE).write_text("{}")
        again = task(drives / "a", drives / "b")
        os.utime(next((drives / "b").glob("*.mcap")), (0, 0))
    else:
        (one.folder / RESULT_FILE).write_text('{"basis": ')
    assert learn_car(again).kept == 0
    assert len(result(again)["drives"]) == len(again.drives.drives)


def test_a_bad_drive_costs_itself_alone(task, drives):
    good = task(drives / "c", drives / "a", folder="good")
    learn_car(good)
    garbage, empty = drives / "garbage.mcap", drives / "empty.csv"
    garbage.write_bytes(b"no bag")
    empty.write_text("")
    halfway = drives / "halfway.csv"  # opens, but its speed is no number
    halfway.write_text("t_s,speed_mps,power_w\n" + "1800000000,nan,5\n" * 3)
    book, columns = drives / "damaged.xlsx", drives / "damaged.parquet"
    book.write_bytes(b"PK\x03\x04" + bytes(range(256)) * 8)
    columns.write_bytes(b"PAR1" + bytes(range(256)) * 8 + b"PAR1")
    bad = (garbage, empty, drives / "gone", halfway, book, columns)
    one = task(drives / "c", drives / "a", *bad)
    done = learn_car(one)
    assert done.failed == len(bad)
    found = result(one)
    problems = [row["problem"] for row in found["unreadable"]] + [
        row["problem"] for row in found["drives"] if row["problem"]
    ]
    assert len(problems) == len(bad) and all(problems)
    assert found["precision"] == result(good)["precision"]
    again = learn_car(one)
    assert again.learned == 0, "a bad drive does not keep the others from being done"


def test_a_new_drive_is_added_beside_a_bad_one(task, drives):
    garbage = drives / "garbage.mcap"
    garbage.write_bytes(b"no bag")
    learn_car(task(drives / "c", garbage))
    done = learn_car(task(drives / "c", garbage, drives / "a"))
    assert (done.learned, done.kept, done.failed) == (1, 1, 1)


def test_a_drive_without_battery_is_no_evidence(task, drives):
    path = drives / "speed.csv"
    rows = [f"{i / 10},{5 + np.sin(i / 20)}," for i in range(600)]
    path.write_text("t_s,speed_mps,power_w\n" + "\n".join(rows))
    one = task(path)
    assert learn_car(one).failed == 0
    assert not np.any(result(one)["precision"])


def test_it_stops_when_asked(task, drives):
    one = task(drives / "c", drives / "a")
    one.stop.touch()
    with pytest.raises(StoppedError):
        learn_car(one)
    assert not one.folder.exists()


def test_it_stops_within_a_drive(task, drives, monkeypatch):
    one = task(drives / "c", drives / "a")
    asked = iter(range(10))

    def stop_if(_):
        if next(asked) == 5:
            raise StoppedError

    monkeypatch.setattr(car_module, "_stop_if", stop_if)
    with pytest.raises(StoppedError):
        learn_car(one)
    assert not (one.folder / RESULT_FILE).exists(), "half a drive is none"
