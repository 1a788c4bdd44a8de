"""A parser of a foreign library may crash, hang or fill up: it does so apart, in one line."""

import tempfile

import pytest

from evpinn_ros.can.logs import LogFile
from evpinn_ros.common import sandbox
from evpinn_ros.logs.sources import open_drive
from test.damage import seeds

PROGRAM = """
import os, sys, threading

def copy(path, out):
    out.write_bytes(path.read_bytes())

def wait(path, out):
    threading.Event().wait()

def turn(path, out):
    while True:
        pass

def fill(path, out):
    held = [bytes(1 << 20) for _ in range(10_000)]

def write(path, out):
    with out.open("wb") as file:
        while True:
            file.write(bytes(1 << 20))

def crash(path, out):
    os.abort()

def panic(path, out):
    raise type("PanicException", (BaseException,), {})("range end index 7")

def leave(path, out):
    sys.exit("broken")
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "said"),
    [
        ("copy", None),
        ("wait", "not read within 3 s"),
        ("turn", "takes more than 1 s to read"),
        ("fill", "takes more than 160 MiB to read"),
        ("write", "File too large"),
        ("crash", "its parser crashed (SIGABRT)"),
        ("panic", "range end index 7"),
        ("leave", "broken"),
    ],
)
def test_whatever_a_parser_does_is_one_line(tmp_path, monkeypatch, function, said):
    (tmp_path / "parsers.py").write_text(PROGRAM)
    (tmp_path / "in").write_text("abc")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    if function in ("wait", "turn"):
        limits = sandbox.ParserLimits(1 << 30, 1 << 30, 1)
        monkeypatch.setattr(sandbox.ParserLimits, "of", lambda _: limits)
        monkeypatch.setattr(sandbox, "PATIENCE", 3.0 if function == "wait" else 60.0)
    if function == "turn":  # the other process asks for itself
        (tmp_path / "sitecustomize.py").write_text(
            "import resource; resource.setrlimit(resource.RLIMIT_CPU, (1, 1))"
        )
    outcome = sandbox.run_apart(f"parsers:{function}", tmp_path / "in", tmp_path / "out")
    assert outcome == said or (said and said in outcome)
    assert function != "copy" or (tmp_path / "out").read_text() == "abc"


def test_what_a_parser_may_take_grows_with_the_file_up_to_what_a_computer_has():
    small, large = sandbox.ParserLimits.of(0), sandbox.ParserLimits.of(1 << 40)
    assert small.memory <= 256 << 20 and small.seconds <= 10
    assert large.memory == sandbox.MOST_MEMORY and large.output == sandbox.MOST_OUTPUT


@pytest.mark.slow
def test_what_was_converted_lasts_without_a_folder(tmp_path, monkeypatch):
    """Which an end would have to remove, and Ctrl-C could interrupt."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "drive.parquet").write_bytes(seeds.parquet_files()[0])
    (tmp_path / "drive.blf").write_bytes(seeds.can_log(".blf")[0])
    drive, frames = (
        open_drive(tmp_path / "drive.parquet"),
        LogFile(tmp_path / "drive.blf").frames(),
    )
    first = next(frames)
    assert not [*(tmp_path / "temporary").iterdir()]
    readings = [*drive.readings()]
    assert first.can_id == 0x18FF0001 and sum(1 for _ in frames) == 39
    assert len(readings) == len([*drive.readings()]) > 30
