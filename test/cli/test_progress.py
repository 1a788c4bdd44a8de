"""Progress of long work in a pipe, and names that were nearly right."""

import io

import pytest
from rich.console import Console

from evpinn_ros.cli import console


@pytest.fixture
def written(monkeypatch) -> io.StringIO:
    """What goes to stderr, which is a pipe; a clock of its own comes as `now`."""
    text = io.StringIO()
    monkeypatch.setattr(console, "notes", Console(file=text, width=200, force_terminal=False))
    return text


def test_a_pipe_has_a_line_every_ten_seconds_and_none_before(written, monkeypatch):
    now = 100.0
    monkeypatch.setattr(console.time, "monotonic", lambda: now)
    with console.progress_bar("urban", total=360.0) as report:
        for done in range(0, 101, 4):  # a second each
            report(float(done))
            now += 1.0
    assert written.getvalue().splitlines() == [
        "urban: 40 s of the drive, 11 %, 80 s left",
        "urban: 80 s of the drive, 22 %, 70 s left",
    ]


def test_reading_many_logs_says_how_far_it_is(written, monkeypatch):
    now = 100.0
    monkeypatch.setattr(console.time, "monotonic", lambda: now)
    for _ in console.track("finding trips", [*range(40)], "logs"):
        now += 0.8
    assert written.getvalue().splitlines()[0] == "finding trips: 13 of 40 logs, 32 %, 22 s left"
    assert [*console.track("finding trips", ["one"], "logs")] == ["one"]
    assert written.getvalue().count("\n") == 3


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("replay", "x.csv", "--vehicle", "nisan_leaf"), "did you mean nissan_leaf"),
        (("replay", "x.csv", "--column", "sped=Speed"), "did you mean speed"),
        (("check-params", "mine.yaml"), "did you mean state_file"),
        (("bench", "unsen"), "did you mean unseen"),
        (("comparee",), "did you mean compare"),
    ],
)
def test_a_name_that_is_nearly_right_is_named(evpinn, tmp_path, arguments, text):
    (tmp_path / "x.csv").write_text("time,Speed,volts,amps\n0,1,350,10\n1,2,350,11\n")
    (tmp_path / "mine.yaml").write_text("estimator:\n  ros__parameters:\n    state_fil: x\n")
    ended = evpinn(*arguments, cwd=tmp_path)
    assert ended.returncode in (1, 2) and text in ended.stderr
