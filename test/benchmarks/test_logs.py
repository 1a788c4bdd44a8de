"""Which logs an argument names, and whose they are."""

from pathlib import Path

import pytest

from benchmarks.logs import Log, find_logs
from evpinn_ros.common.errors import InputError

pytestmark = pytest.mark.slow


@pytest.fixture
def folder(empty_files) -> Path:
    return empty_files(
        *("b/drive.csv.gz", "b/notes.txt", "a.log", "b/c/can.ASC"),
        *("bag/bag_0.mcap", "bag/inside.csv", "x.gz"),
    )


def test_a_folder_is_searched_and_a_bag_is_one_log(folder):
    found = find_logs(str(folder), "generic")
    names = [str(log.path.relative_to(folder)) for log in found]
    assert names == ["a.log", "b/c/can.ASC", "b/drive.csv.gz", "bag"]
    assert {log.vehicle for log in found} == {"generic"}


def test_a_path_may_say_whose_it_is(folder):
    path = folder / "a.log"
    assert find_logs(f"{path}=bmw_i3", "generic") == [Log(path, "bmw_i3", None)]
    wanted = Log(path, "tesla_model_3_lr", "tesla_model_3_2019")
    assert find_logs(f"{path}=tesla_model_3_lr,tesla_model_3_2019", "generic") == [wanted]
    assert {log.vehicle for log in find_logs(f"{folder}=bmw_i3", "generic")} == {"bmw_i3"}


def test_a_name_with_an_equals_sign_is_a_name(folder):
    path = folder / "run=7.csv"
    path.write_text("")
    assert find_logs(str(path), "generic") == [Log(path, "generic", None)]
    assert find_logs(f"{path}=bmw_i3", "generic") == [Log(path, "bmw_i3", None)]


def test_nothing_there_is_said(folder):
    (folder / "empty").mkdir()
    for path, reason in (
        ("nowhere", "no such"),
        ("nowhere=bmw_i3", "no such"),
        ("empty", "no bag"),
    ):
        with pytest.raises(InputError, match=reason):
            find_logs(str(folder / path), "generic")
