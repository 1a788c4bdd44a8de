"""A file is whole or not there, whatever ends its writing."""

import errno
import os

import pytest

from evpinn_ros.common.writer import replaced


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_draft_takes_the_place_of_the_file(tmp_path):
    path = tmp_path / "car.json"
    for text in ("one", "two"):
        with replaced(path) as draft:
            draft.write_text(text)
        assert path.read_text() == text and names(tmp_path) == ["car.json"]


@pytest.mark.parametrize("end", [OSError(errno.ENOSPC, "full"), ValueError(), KeyboardInterrupt()])
@pytest.mark.parametrize("before", [None, "old"])
def test_what_is_not_whole_leaves_nothing(tmp_path, end, before):
    path = tmp_path / "car.json"
    if before is not None:
        path.write_text(before)

    def write():
        with replaced(path) as draft:
            draft.write_text("half")
            raise end

    with pytest.raises(type(end)):
        write()
    assert names(tmp_path) == ([] if before is None else ["car.json"])
    assert before is None or path.read_text() == before


def test_a_link_goes_on_to_lead_to_the_file(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link.json").symlink_to(tmp_path / "real" / "car.json")
    with replaced(tmp_path / "link.json") as draft:
        draft.write_text("new")
    assert (tmp_path / "link.json").is_symlink()
    assert (tmp_path / "real" / "car.json").read_text() == "new"
    assert names(tmp_path / "real") == ["car.json"]


def test_a_device_is_written_to_and_stays_one(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reading = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    with replaced(tmp_path / "pipe") as draft:
        draft.write_text("through")
    assert os.read(reading, 100) == b"through" and names(tmp_path) == ["pipe"]
    os.close(reading)
