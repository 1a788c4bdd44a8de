"""The state file beside its node: what is refused is kept."""

from pathlib import Path

import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes.saved_state import REFUSED_KEPT, StateFile, state_path


class Counter:
    """Takes states of its own kind alone."""

    def __init__(self):
        self.count = 0

    def export(self):
        return {"count": self.count}

    def restore(self, state):
        self.count = state["count"]

    def reset(self):
        self.count = 0


def refuse_and_save(path):
    state_file = StateFile(path, Counter())
    state_file.load()
    assert f"{path.name}.refused" in state_file.problem
    assert state_file.save() is None and state_file.problem is None


def test_the_newest_refused_files_are_kept(tmp_path):
    path = tmp_path / "car.json"
    for number in range(REFUSED_KEPT + 2):
        path.write_text(f"broken {number}")
        refuse_and_save(path)
    kept = sorted(tmp_path.glob("car.json.refused*"))
    assert [file.name.removeprefix("car.json.refused") for file in kept] == [
        "",
        ".2",
        ".3",
        ".4",
        ".5",
    ]
    newest = [f"broken {number}" for number in range(REFUSED_KEPT + 1, 1, -1)]
    assert [file.read_text() for file in kept] == newest


def test_a_file_that_was_used_is_not_set_aside(tmp_path):
    path = tmp_path / "car.json"
    for _ in range(2):
        state_file = StateFile(path, Counter())
        state_file.load()
        assert state_file.problem is None and state_file.save() is None
    assert [file.name for file in tmp_path.iterdir()] == ["car.json"]


def test_the_home_of_nobody_is_one_line():
    assert state_path("") is None and state_path("~/car.json") == Path.home() / "car.json"
    with pytest.raises(InputError, match=r"~nobody_here/car.json: no home"):
        state_path("~nobody_here/car.json")
