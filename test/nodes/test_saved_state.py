"""The state file beside its node: what is refused is kept."""

import os
from pathlib import Path

import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.estimation.state_file import (
    REFUSED_KEPT,
    Half,
    account_path,
    append_half,
    read_half,
    read_state,
    write_halves,
    write_state,
)
from evpinn_ros.nodes.saved_state import MOST_APPENDED, StateFile, state_path


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


def test_the_newest_refused_files_are_kept(tmp_path):
    path = tmp_path / "car.json"
    for number in range(REFUSED_KEPT + 2):
        path.write_text(f"broken {number}")
        state_file = StateFile(path, Counter(), Half.LEARNED)
        state_file.restore()
        assert "car.json.refused" in state_file.problem
        assert state_file.save() is None and state_file.problem is None
    kept = sorted(tmp_path.glob("car.json.refused*"))
    numbers = [file.name.removeprefix("car.json.refused") for file in kept]
    assert numbers == ["", ".2", ".3", ".4", ".5"]
    newest = [f"broken {number}" for number in range(REFUSED_KEPT + 1, 1, -1)]
    assert [file.read_text() for file in kept] == newest


def test_the_second_user_of_a_half_is_told_and_writes_nothing(tmp_path):
    path = tmp_path / "car.json"
    write_halves(path, {Half.LEARNED: {"count": 5}})
    first, second = (StateFile(path, Counter(), Half.LEARNED) for _ in range(2))
    for state_file in (first, second):
        state_file.restore()
        state_file._owner.count += 1
    assert first.problem is None
    for problem in (second.problem, second.save(), second.problem):
        assert f"{path}: another evpinn learns into this file" in problem
    assert second.start, "it begins with what is known"
    assert first.save() is None and read_state(path) == {"learned": {"count": 6}}
    first.release()
    assert second.save() is not None, "it began before the first wrote"
    third = StateFile(path, Counter(), Half.LEARNED)
    third.restore()
    assert third.problem is None and third._owner.count == 6


def test_a_refused_half_is_kept_and_costs_the_other_nothing(tmp_path):
    path = tmp_path / "car.json"
    write_halves(path, {Half.LEARNED: {"wrong": 1}, Half.ENERGY: {"count": 7}})
    files = [StateFile(path, Counter(), half) for half in Half]
    for state_file in files:
        state_file.restore()
    assert "car.json.refused" in files[0].problem and files[1].problem is None
    for state_file in files:
        assert state_file.save() is None
    assert read_state(path) == {"learned": {"count": 0}, "energy": {"count": 7}}
    assert read_state(tmp_path / "car.json.refused")["learned"] == {"wrong": 1}


def test_a_file_that_both_nodes_refuse_is_kept_once(tmp_path):
    path = tmp_path / "car.json"
    path.write_text("broken")
    files = [StateFile(path, Counter(), half) for half in Half]
    for state_file in files:
        state_file.restore()
    for state_file in files:
        assert state_file.save() is None
        state_file.release()
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept == ["car.json", "car.json.refused"]
    assert read_state(path) == {"learned": {"count": 0}, "energy": {"count": 0}}


def test_files_of_earlier_versions_become_one_and_lose_nothing(tmp_path):
    path = tmp_path / "car.json"
    account = {"version": 1, "vehicle": "bmw_i3", "before_reset": {}, "count": 3}
    write_state(path, {"version": 1, "vehicle": "bmw_i3", "count": 2})
    write_state(account_path(path), account)
    files = [StateFile(path, Counter(), half) for half in Half]
    for state_file in files:
        state_file.restore()
        assert state_file.problem is None and state_file.save() is None
    assert read_state(path) == {"learned": {"count": 2}, "energy": {"count": 3}}
    assert read_state(account_path(path)) == account
    write_state(account_path(path), {**account, "count": 9})  # which is read no more
    assert read_half(path, Half.ENERGY) == ({"count": 3}, None)


def test_wherever_a_line_is_torn_the_file_holds_this_state_or_the_one_before(tmp_path):
    path, other = tmp_path / "car.json", {"count": 1}
    write_halves(path, {Half.LEARNED: other})
    for count in range(3):
        append_half(path, Half.ENERGY, {"count": count})
    content = path.read_bytes()
    newest = len(content) - content.rindex(b"\n")
    for cut in range(newest + 1):
        for lost in (b"", b"\0" * cut):
            path.write_bytes(content[: len(content) - cut] + lost)
            assert read_state(path) == {"learned": other, "energy": {"count": 2 if not cut else 1}}
    write_halves(path, {Half.LEARNED: {"count": 9}})
    assert path.read_text() == '{"learned": {"count": 9}, "energy": {"count": 1}}'
    lines = b'\n{"energy": 1}', b"\n[]\n{}", b"\nx\n" + content, b"\n{}"
    for damaged in (*(content + line for line in lines), b"{}" + content, b'{"energy": {}} {}'):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="not a saved state"):
            read_state(path)


def test_a_state_is_appended_and_now_and_then_written_whole(tmp_path):
    path = tmp_path / "car.json"
    state_file = StateFile(path, Counter(), Half.ENERGY)
    state_file.restore()
    lines = []
    for count in range(2 * MOST_APPENDED + 2):
        state_file._owner.count = count
        state_file.append()
        lines.append(len(path.read_text().splitlines()))
        assert read_state(path) == {"energy": {"count": count}}
    assert lines == [*range(1, MOST_APPENDED + 2)] * 2


def test_a_half_that_is_missing_is_reported(tmp_path):
    path = tmp_path / "car.json"
    write_halves(path, {Half.ENERGY: {"count": 3}})
    state_file = StateFile(path, Counter(), Half.LEARNED)
    state_file.restore()
    assert "holds no 'learned'" in state_file.problem
    state_file.append()
    assert read_state(path) == {"learned": {"count": 0}, "energy": {"count": 3}}
    assert state_file.problem is None


def test_the_home_of_nobody_is_one_line():
    assert state_path("") is None and state_path("~/car.json") == Path.home() / "car.json"
    with pytest.raises(InputError, match=r"~nobody_here/car.json: no home"):
        state_path("~nobody_here/car.json")


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo], ids=["folder", "pipe"])
def test_what_is_no_file_stays_where_it_is(tmp_path, make):
    """It was renamed as if it were a refused state: a folder, and for root /dev/null."""
    make(path := tmp_path / "car.json")
    state_file = StateFile(path, Counter(), Half.LEARNED)
    state_file.restore()
    assert str(path) in state_file.problem and "kept" not in state_file.problem
    assert "not a regular file" in state_file.save()
    assert [path.name for path in tmp_path.iterdir()] == ["car.json"]
