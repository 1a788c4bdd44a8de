"""No command writes over what it reads, whatever named the file that it reads."""

import gzip
from pathlib import Path
import re

import numpy as np
import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import open_file
from evpinn_ros.common.writer import replaced, write_file

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
DRIVE = "time,speed [m/s],voltage [V],current [A],latitude,longitude\n" + "".join(
    f"{second},{10 + second % 7},380,{20 + second % 5},48.5,{11.5 + second * 1e-4:.4f}\n"
    for second in range(120)
)


@pytest.fixture
def inputs(tmp_path):
    """A folder of drives, a plan, a tile, a vehicle file, and its profile with its DBC."""
    (tmp_path / "drives").mkdir()
    for name in ("a.csv", "b.csv"):
        (tmp_path / "drives" / name).write_text(DRIVE)
    (tmp_path / "plan.csv").write_text("t_s,speed_mps\n0,0\n10,10\n60,10\n70,0\n")
    (tmp_path / "tiles").mkdir()
    tile = gzip.compress(np.full((1201, 1201), 500, ">i2").tobytes(), 1)
    (tmp_path / "tiles" / "N48E011.hgt.gz").write_bytes(tile)
    for name in ("tesla_model_3.yaml", "tesla_model_3.dbc"):
        (tmp_path / name).write_bytes((ROOT / "config" / "can" / name).read_bytes())
    text = (ROOT / "config" / "vehicles" / "tesla_model_3_lr.yaml").read_text()
    text = re.sub(r"(?m)^can_profile: .*$", "can_profile: tesla_model_3.yaml", text)
    (tmp_path / "car.yaml").write_text(text)
    return tmp_path


REPLAY = "replay drives --vehicle bmw_i3 --whole"
SIMULATE = "simulate new --duration 60 --vehicle car.yaml"


@pytest.mark.parametrize(
    ("command", "victim"),
    [
        (f"{REPLAY} --report", "drives/b.csv"),
        (f"{REPLAY} --elevation tiles --report", "tiles/N48E011.hgt.gz"),
        ("compare drives/a.csv drives/b.csv --elevation tiles --report", "tiles/N48E011.hgt.gz"),
        ("forecast drives/a.csv --elevation tiles --report", "tiles/N48E011.hgt.gz"),
        ("forecast plan.csv --report", "plan.csv"),
        (f"{SIMULATE} --can-log", "car.yaml"),
        (f"{SIMULATE} --can-log", "tesla_model_3.yaml"),
        (f"{SIMULATE} --can-log", "tesla_model_3.dbc"),
        ("replay new.log --vehicle car.yaml --report", "tesla_model_3.yaml"),
        ("replay new.log --vehicle car.yaml --report", "tesla_model_3.dbc"),
        ("fleet drives --vehicle car.yaml --out out --write-vehicle", "tesla_model_3.yaml"),
    ],
)
def test_no_command_writes_over_what_it_reads(evpinn, inputs, command, victim):
    if "new.log" in command:
        assert evpinn(*SIMULATE.split(), "--can-log", "new.log", cwd=inputs).returncode == 0
    before = {path: path.read_bytes() for path in inputs.rglob("*") if path.is_file()}
    run = evpinn(*command.split(), victim, cwd=inputs)
    assert run.returncode == 1
    lines = [line for line in run.stderr.splitlines() if line.startswith("evpinn:")]
    assert len(lines) == 1 and "would be written over the input" in lines[0], run.stderr
    assert {path: path.read_bytes() for path in before} == before


def test_whatever_was_opened_is_not_written_over(tmp_path):
    path, link = tmp_path / "input", tmp_path / "link"
    path.write_text("measured")
    link.hardlink_to(path)
    open_file(path).close()
    for name in (path, link):
        with pytest.raises(InputError, match="over the input"):
            write_file(name, "new")
    with replaced(path, update=True) as draft:
        draft.write(b"state")
    assert (path.read_text(), link.read_text()) == ("state", "measured")


def test_what_this_process_wrote_and_read_it_writes_again(tmp_path):
    for content in ("first", "second"):
        write_file(tmp_path / "own", content)
        with open_file(tmp_path / "own") as file:
            assert file.read().decode() == content
