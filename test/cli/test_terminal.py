"""Names of files, topics and types come from anywhere: they are shown, and obeyed by nobody."""

import csv
import json
import math
import os
from pathlib import Path
import subprocess
import sys

from mcap.writer import Writer
import pytest
import typer
from typer.testing import CliRunner

from evpinn_ros.cli.console import write_json
from evpinn_ros.cli.main import app
from evpinn_ros.cli.simulate import simulate

ROOT = Path(__file__).parents[2]
ESCAPES = "\x1b[2J\x1b]0;owned\x07\r\b\x9b1m\u202e"
MARKUP = "[/bold][red]:smile:[/]"


def process(*arguments, out=subprocess.PIPE, **environment) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "evpinn_ros", *map(str, arguments)],
        env={"PYTHONPATH": str(ROOT), "COLUMNS": "300", "OMP_NUM_THREADS": "1", **environment},
        stdout=out,
        stderr=subprocess.PIPE,
        timeout=150,
    )


@pytest.fixture
def hostile(tmp_path) -> Path:
    """A bag whose every name speaks to the terminal and to rich."""
    path = tmp_path / f"{ESCAPES}[red].mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", ESCAPES)
        schema = writer.register_schema(f"{ESCAPES}/{MARKUP}", "ros2msg", b"float64 data\n")
        channel = writer.register_channel(f"/{MARKUP}{ESCAPES}", "cdr", schema)
        for second in range(5):
            writer.add_message(channel, second * 10**9, bytes(12), second * 10**9)
        writer.finish()
    return path


def assert_harmless(text: bytes) -> None:
    shown = text.decode()
    assert all(character.isprintable() or character == "\n" for character in shown)


def test_foreign_names_are_shown_as_they_are(hostile):
    ended = process("info", hostile)
    assert ended.returncode == 0, ended.stderr
    assert MARKUP in ended.stdout.decode()
    assert_harmless(ended.stdout)
    assert_harmless(ended.stderr)


def test_foreign_names_in_errors_and_recovery(evpinn, hostile, tmp_path):
    (tmp_path / f"{MARKUP[7:]}{ESCAPES}.csv".replace("/", "")).write_text("a,b\n1,2\n")
    (column_file,) = tmp_path.glob("*.csv")
    for arguments in (
        ("info", column_file),
        ("recover", hostile, tmp_path / "saved"),
        ("replay", hostile, "--vehicle", "nissan_leaf"),
        ("can", "inspect", hostile),
        ("convert", hostile, tmp_path / f"{ESCAPES}out", "--vehicle", "nissan_leaf"),
    ):
        ended = evpinn(*arguments, cwd=tmp_path)
        assert "Traceback" not in ended.stderr, arguments
        assert_harmless((ended.stdout + ended.stderr).encode())


def test_json_of_monstrous_numbers_has_nulls(tmp_path, capsys):
    write_json(Path("-"), [{"distance": math.inf, "pair": (math.nan, 1.0)}])
    assert json.loads(capsys.readouterr().out) == [{"distance": None, "pair": [None, 1.0]}]
    with (tmp_path / "huge.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(("t_s", "speed_mps", "voltage_v", "current_a"))
        rows.writerows((second, 1e308, 1e308, 1e308) for second in range(100))
    ended = process("info", "--json", "-", tmp_path / "huge.csv")
    assert b"Traceback" not in ended.stderr and isinstance(json.loads(ended.stdout), list)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux has this device alone")
@pytest.mark.parametrize("arguments", [("info",), ("info", "--json", "-"), ("--help",)])
def test_a_full_device_is_said_in_one_line(arguments):
    bag = () if "--help" in arguments else (ROOT / "bags" / "urban",)
    with Path("/dev/full").open("wb") as full:
        ended = process(*arguments, *bag, out=full)
    assert ended.returncode == 1
    *tables, error = ended.stderr.decode().splitlines()
    assert error == "evpinn: the output: No space left on device"
    assert "--json" in arguments or not tables


def test_a_terminal_without_all_letters_gets_those_that_it_has(hostile):
    ended = process("info", hostile, PYTHONIOENCODING="ascii", LC_ALL="C")
    assert ended.returncode == 0 and b"Traceback" not in ended.stderr


def test_a_name_that_is_no_text_is_shown(tmp_path):
    path = os.fsencode(tmp_path) + b"/\xff\xfe.csv"
    Path(os.fsdecode(path)).write_text("a,b\n1,2\n")
    ended = process("info", os.fsdecode(path))
    assert ended.returncode == 1 and b"Traceback" not in ended.stderr


@pytest.mark.parametrize("number", ["1" + ":01" * 30_000, "!!int 1:30", "!!float 1:30.5"])
def test_numbers_of_base_60_are_none(evpinn, tmp_path, number):
    (tmp_path / "mine.yaml").write_text(
        f"estimator:\n  ros__parameters:\n    update_period: {number}\n"
    )
    ended = evpinn("check-params", "mine.yaml", cwd=tmp_path)
    assert ended.returncode == 1 and "Traceback" not in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


def test_a_command_after_one_that_gave_json_prints_its_tables(tmp_path):
    """In one process, as notebooks and tests run them."""
    assert CliRunner().invoke(app, ["vehicles", "search", "leaf", "--json", "-"]).exit_code == 0
    drive, alone = str(tmp_path / "drive"), typer.Typer()
    alone.command()(simulate)
    assert drive in CliRunner().invoke(alone, [drive, "--duration", "60"]).stdout
