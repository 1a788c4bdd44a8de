"""No command writes over what it reads, whatever named the file that it reads."""

from datetime import date
import gzip
import os
from pathlib import Path
from random import Random
import re
import shutil

import numpy as np
import pytest

from evpinn_ros.common import opener
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import open_file
from evpinn_ros.common.writer import replaced, write_file
from test.opened import opened_to_read

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
DRIVE = "time,speed [m/s],voltage [V],current [A],latitude,longitude\n" + "".join(
    f"{second},{10 + second % 7},380,{20 + second % 5},48.5,{11.5 + second * 1e-4:.4f}\n"
    for second in range(120)
)


@pytest.fixture
def inputs(tmp_path):
    return _inputs_in(tmp_path)


def _inputs_in(tmp_path):
    """Drives in a folder and one of JSON, a plan, a tile, a vehicle file, its profile and DBC."""
    (tmp_path / "drives").mkdir()
    for name in ("a.csv", "b.csv"):
        (tmp_path / "drives" / name).write_text(DRIVE)
    row = '{{"t_s": {}, "speed_mps": 10, "power_w": 2}}\n'
    (tmp_path / "c.jsonl").write_text("".join(map(row.format, range(120))))
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
        ("bench plans c.jsonl=car.yaml --json", "c.jsonl"),
    ],
)
def test_no_command_writes_over_what_it_reads(evpinn, inputs, command, victim):
    if "new.log" in command:
        assert evpinn(*SIMULATE.split(), "--can-log", "new.log", cwd=inputs).returncode == 0
    before = {path: path.read_bytes() for path in inputs.rglob("*") if path.is_file()}
    run = evpinn(*command.split(), victim, cwd=inputs)
    assert run.returncode == 1
    lines = [line for line in run.stderr.splitlines() if line.startswith("evpinn:")]
    errors = [line for line in lines if "read as a drive by" not in line]
    assert len(errors) == 1 and "would be written over the input" in errors[0], run.stderr
    assert {path: path.read_bytes() for path in before} == before


COMMANDS = {
    "replay drives --vehicle car.yaml --whole --params p.yaml": (
        *("--report", "--metrics", "--out", "--state"),
    ),
    "replay drives/a.csv new.log bag --vehicle car.yaml --state s.json": (
        *("--report", "--metrics", "--out"),
    ),
    "compare drives/a.csv drives/b.csv --vehicle car.yaml --elevation tiles --params p.yaml": (
        *("--report", "--json"),
    ),
    "forecast plan.csv c.jsonl --vehicle car.yaml --elevation tiles": ("--report", "--json"),
    "forecast plan.csv --state s.json": ("--report", "--json"),
    "info drives c.jsonl plan.csv new.log bag --can-profile ./tesla_model_3.yaml": ("--json",),
    "can inspect new.log --can-profile ./tesla_model_3.yaml": ("--json",),
    "recover bag/bag_0.mcap new": ("--json",),
    "recover bag": ("",),
    "convert drives/a.csv --vehicle car.yaml": ("",),
    "convert new.log --vehicle car.yaml": ("",),
    "convert bag --storage sqlite3": ("",),
    "simulate new --duration 60 --vehicle car.yaml": ("--can-log",),
    "simulate --duration 60 --vehicle car.yaml": ("",),
    "bench plans c.jsonl=car.yaml": ("--json",),
    "fleet drives --vehicle car.yaml --out out": ("--report", "--write-vehicle", "--json"),
    "fleet --manifest fleet.yaml --out out": ("--report", "--write-vehicle", "--json"),
}
"""All that write what they are told to, and the options that say where; "" is an argument."""

STATE = "s.json"


@pytest.fixture(scope="module")
def whole_inputs(tmp_path_factory, evpinn):
    """Beside them a bag, a CAN log, a state, parameters and a manifest."""
    folder = _inputs_in(tmp_path_factory.mktemp("inputs"))
    (folder / "p.yaml").write_bytes((ROOT / "config" / "evpinn.param.yaml").read_bytes())
    (folder / "fleet.yaml").write_text("cars: {a: {vehicle: car.yaml, drives: drives}}\n")
    for command in (
        f"{SIMULATE} --can-log new.log",
        "convert drives/a.csv bag --vehicle car.yaml",
        "replay drives/a.csv --vehicle car.yaml --state s.json",
    ):
        assert evpinn(*command.split(), cwd=folder).returncode == 0
    shutil.rmtree(folder / "new")
    return folder


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("attempts", [4, pytest.param(300, marks=pytest.mark.nightly)])
def test_what_a_command_has_read_stays_whatever_is_named_as_output(
    whole_inputs, tmp_path, evpinn, monkeypatch, attempts
):
    """By its name, by another, by a link."""
    names = [path.relative_to(whole_inputs) for path in whole_inputs.rglob("*") if path.is_file()]
    refused = 0
    for number in range(attempts):
        day = "day" if attempts < 10 else os.environ.get("EVPINN_NIGHT", date.today().isoformat())
        chance = Random(f"{day} outputs {number}")
        folder = Path(shutil.copytree(whole_inputs, tmp_path / str(number)))
        command = chance.choice([*COMMANDS])
        option, victim = chance.choice(COMMANDS[command]), folder / chance.choice(sorted(names))
        given = chance.choice(("name", "dots", "symlink", "hardlink"))
        output = folder / "other.html" if given.endswith("link") else victim
        if given == "dots":
            output = folder / "drives" / ".." / victim.relative_to(folder)
        elif given == "symlink":
            output.symlink_to(victim)
        elif given == "hardlink":
            output.hardlink_to(victim)
        before = {path: path.read_bytes() for path in map(folder.joinpath, names)}
        monkeypatch.setattr(opener, "_files", {})  # as in a process of its own
        with opened_to_read() as read:
            run = evpinn(*command.split(), *[option] * bool(option), output, cwd=folder)
        if "fleet" in command:  # in processes of their own
            read |= {*folder.glob("drives/*")}
        if "bench" in command:
            read.add(folder / "c.jsonl")
        if "replay" in command and (victim.name != STATE or option == "--state"):
            read.discard(folder / STATE)  # which is learned on
        changed = {path for path, content in before.items() if path.read_bytes() != content}
        case = f"{day} {number}: evpinn {command} {option} {output}: {run.stderr}"
        assert not {path.resolve() for path in changed} & read, case
        if victim.resolve() in read:
            assert run.returncode in (1, 2) and not changed, case
            refused += run.returncode == 1
        shutil.rmtree(folder)
    assert refused >= attempts // 10


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


def test_an_input_that_has_the_number_of_a_file_of_ours_that_is_gone_is_an_input(tmp_path):
    numbers = set()
    for turn in range(50):  # until the file system gives a number again
        own, path = tmp_path / f"own{turn}", tmp_path / f"input{turn}"
        write_file(own, "mine")
        numbers.add(own.stat().st_ino)
        own.unlink()
        path.write_text("measured")
        if path.stat().st_ino in numbers:
            open_file(path).close()
            with pytest.raises(InputError, match="over the input"):
                write_file(path, "new")
            return
    pytest.skip("this file system gives no number again")


def test_what_this_process_wrote_and_read_it_writes_again(tmp_path):
    for content in ("first", "second"):
        write_file(tmp_path / "own", content)
        with open_file(tmp_path / "own") as file:
            assert file.read().decode() == content
