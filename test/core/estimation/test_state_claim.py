"""A state has one process that learns into it: nothing learned is lost to another."""

import os
from pathlib import Path
import subprocess
import sys

import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.estimation.state_file import Half, StateClaim, read_state

COUNTER = """
import sys
from pathlib import Path
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.estimation.state_file import Half, StateClaim, read_half, write_halves
path, done = Path(sys.argv[1]), 0
while done < 150:
    try:
        with StateClaim(path):
            state, _ = read_half(path, Half.LEARNED)
            count = (state or {"count": 0})["count"]
            write_halves(path, {Half.LEARNED: {"count": count + 1}})
            done += 1
    except InputError as error:
        assert "another evpinn learns into this file" in str(error), error
"""


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.slow
def test_of_three_processes_none_loses_an_update(tmp_path):
    path = tmp_path / "car.json"
    command = [sys.executable, "-c", COUNTER, str(path)]
    processes = [subprocess.Popen(command) for _ in range(3)]
    assert [process.wait(timeout=300) for process in processes] == [0, 0, 0]
    assert read_state(path)["learned"] == {"count": 450}
    assert names(tmp_path) == ["car.json"]


def test_the_halves_have_a_holder_each_and_a_command_needs_both(tmp_path):
    path = tmp_path / "new" / "car.json"
    with StateClaim(path, [Half.LEARNED]):
        with StateClaim(path, [Half.ENERGY]), StateClaim(tmp_path / "new" / "other.json"):
            pass
        for halves in ([Half.LEARNED], Half):
            with pytest.raises(InputError, match=r"car\.json: another evpinn learns into this"):
                StateClaim(path, halves)
        with StateClaim(path, [Half.ENERGY]):  # which the refused one did not keep
            pass
    assert names(tmp_path / "new") == []


def test_a_link_and_its_file_are_one_state(tmp_path):
    (tmp_path / "link.json").symlink_to(tmp_path / "car.json")
    with StateClaim(tmp_path / "link.json"), pytest.raises(InputError, match="another evpinn"):
        StateClaim(tmp_path / "car.json")


def test_a_killed_process_holds_nothing(tmp_path):
    path = tmp_path / "car.json"
    code = (
        "import os, sys; from pathlib import Path\n"
        "from evpinn_ros.core.estimation.state_file import StateClaim\n"
        "claim = StateClaim(Path(sys.argv[1])); os._exit(9)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(path)], timeout=60).returncode == 9
    assert len(names(tmp_path)) == 2
    with StateClaim(path):
        pass
    assert names(tmp_path) == []


def test_a_fork_that_ends_takes_nothing_from_its_parent(tmp_path):
    claim = StateClaim(tmp_path / "car.json")
    if (child := os.fork()) == 0:
        claim.release()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    with pytest.raises(InputError, match="another evpinn"):
        StateClaim(tmp_path / "car.json")
    claim.release()


def test_where_no_lock_can_be_made_and_of_a_device_nothing_is_claimed(tmp_path):
    (tmp_path / "file").write_text("")
    with StateClaim(tmp_path / "file" / "car.json"), StateClaim(Path("/dev/null")):
        pass
    with StateClaim(None):
        pass
