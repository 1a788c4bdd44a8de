"""Progress of long work in a pipe, and names that were nearly right."""

from contextlib import nullcontext
import io

import pytest
from rich.console import Console

from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.logs import write_log
from evpinn_ros.cli import can as can_commands
from evpinn_ros.cli import console, convert, info
from evpinn_ros.extras.paper.run import training_progress


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


def test_without_a_length_no_time_left_is_claimed(written, monkeypatch):
    now = 0.0
    monkeypatch.setattr(console.time, "monotonic", lambda: now)
    with console.progress_bar("log", total=None, unit="rows") as report:
        now = 11.0
        report(5000.0)
    with console.bytes_bar("bag", total=4_000_000) as report:
        now = 22.0
        report(1_000_000)
    assert written.getvalue().splitlines() == ["log: 5000 rows", "bag: 1 MB, 25 %, 33 s left"]


@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        (info, ("info", "drive.csv")),
        (convert, ("convert", "drive.csv", "bag")),
        (can_commands, ("can", "inspect", "drive.log")),
    ],
    ids=lambda each: each[0] if isinstance(each, tuple) else "",
)
def test_tables_and_can_logs_have_a_length(evpinn, tmp_path, monkeypatch, module, arguments):
    rows = [f"{0.1 * i:.1f},{i % 20},350,10" for i in range(101)]
    text = "\n".join(["time,Speed (km/h),volts,amps", *rows]) + "\n"
    (tmp_path / "drive.csv").write_text(text)
    frames = [CanFrame(10**18 + i * 10**8, 0x132, bytes(8), False) for i in range(101)]
    write_log(tmp_path / "drive.log", frames)
    totals = []

    def bar(title, total, unit=""):
        totals.append(total)
        return nullcontext(lambda done: None)

    monkeypatch.setattr(module, "progress_bar", bar)
    evpinn(*arguments, cwd=tmp_path)
    assert totals == [pytest.approx(10.0)]


def test_trainings_have_a_line_each(written, monkeypatch):
    now = 0.0
    monkeypatch.setattr(console.time, "monotonic", lambda: now)
    with training_progress() as report:
        for title in ("power network", "energy networks"):
            for epoch in (10, 20, 30):
                report(title, epoch, 40, 0.5)
                now += 6.0
    assert written.getvalue().splitlines() == [
        "power network, 1 of 3: 30 of 40 epochs, 75 %, 4 s left",
        "energy networks, 3 of 3: 30 of 40 epochs, 75 %, 4 s left",
    ]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("replay", "x.csv", "--vehicle", "nisan_leaf"), "did you mean nissan_leaf"),
        (("replay", "x.csv", "--column", "speed=Sped"), "did you mean Speed"),
        (("replay", "x.csv", "--column", "sped=Speed"), "did you mean speed"),
        (("can", "inspect", "x.csv", "--can-profile", "nisan_leaf"), "did you mean nissan_leaf"),
        (("simulate", "out", "--true", "c_rrr=0.01"), "did you mean c_rr"),
        (("check-params", "mine.yaml"), "did you mean state_file"),
        (("bench", "unsen"), "did you mean unseen"),
        (("comparee",), "did you mean compare"),
    ],
)
def test_a_name_that_is_nearly_right_is_named(evpinn, tmp_path, arguments, text):
    (tmp_path / "x.csv").write_text("time,Speed,volts,amps\n0,1,350,10\n1,2,350,11\n")
    (tmp_path / "mine.yaml").write_text("estimator:\n  ros__parameters:\n    state_fil: x\n")
    done = evpinn(*arguments, cwd=tmp_path)
    assert done.returncode in (1, 2) and text in done.stderr
