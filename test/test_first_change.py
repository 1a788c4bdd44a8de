"""The three changes that CONTRIBUTING.md walks through, made in a copy of the repository."""

from collections.abc import Iterator
import json
import os
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys
from textwrap import dedent

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
FIRST, APP, TERM = "Your first change", "The log of an app", "A term of the equation"
SEE_TERM = """
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.energy.power_model import Weather, even_steps, vehicle_model
from evpinn_ros.core.vehicle.files import load_vehicle
import numpy as np

steps = even_steps(*np.array([[2.0], [40.0], [0.0]]))  # 2 s, 40 m, no climb
rows = vehicle_model(load_vehicle("bmw_i3")).rows(steps, Weather(1.2))
print("J for 1 N/(m/s):", rows[0, State.OIL])
"""
LEFT_OUT = shutil.ignore_patterns(".*", "build", "install", "log", "out", "*.egg-info")


def block(heading: str, language: str) -> str:
    """The one block of code in this language of a section, without its indentation."""
    (section,) = re.findall(rf"^## {heading}.*?(?=^## )", PAGE, re.DOTALL | re.MULTILINE)
    (text,) = re.findall(rf"^   ```{language}\n(.*?)^   ```$", section, re.DOTALL | re.MULTILINE)
    return dedent(text)


@pytest.fixture
def copy(tmp_path) -> Iterator[Path]:
    """The checkout, with the environment of this Python as its `.venv`."""
    folder = tmp_path / "copy"
    # With what is compiled, which holds for files of the same time and takes seconds to make.
    shutil.copytree(ROOT, folder, ignore=LEFT_OUT)
    (folder / ".venv").mkdir()
    for name in ("bin", "lib", "pyvenv.cfg"):
        (folder / ".venv" / name).symlink_to(Path(sys.prefix) / name)
    (folder / ".venv" / "installed").touch()
    yield folder
    shutil.rmtree(folder)


def run(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Run a command of the page as its reader does: outside of this `make` and this pytest."""
    kept = {
        name: value for name, value in os.environ.items() if not re.match("M(AK|F)|PYTEST", name)
    }
    path = f"{folder / '.venv' / 'bin'}{os.pathsep}{kept['PATH']}"
    environment = {**kept, "PATH": path, "PYTHONPATH": str(folder)}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def apply(folder: Path, diff: str, *options: str) -> None:
    command = ["git", "apply", *options, "-"]
    subprocess.run(command, input=diff.encode(), cwd=folder, check=True)


@pytest.fixture
def with_new_test(copy) -> Path:
    page = copy / "test" / "logs" / "test_columns.py"
    text = page.read_text(encoding="utf-8")
    page.write_text(f"{text}\n\n{block(FIRST, 'python')}", encoding="utf-8")
    return copy


@pytest.mark.build
def test_the_test_fails_before_the_change_and_passes_after_it(with_new_test):
    command = shlex.split(re.search(r"`(\.venv/bin/pytest [^`]+)`", PAGE)[1])
    before = run(with_new_test, *command)
    assert "1 failed" in before.stdout, before.stdout + before.stderr
    apply(with_new_test, block(FIRST, "diff"))
    after = run(with_new_test, *command)
    assert after.returncode == 0 and "1 passed" in after.stdout, after.stdout + after.stderr


@pytest.fixture
def with_term(copy) -> Path:
    apply(copy, block(TERM, "diff"), "--unidiff-zero")
    return copy


@pytest.mark.build
def test_a_term_is_two_lines(with_term):
    ended = run(with_term, "python", "-c", SEE_TERM)
    assert ended.stdout == "J for 1 N/(m/s): 800.0\n", ended.stderr


@pytest.mark.build
def test_an_app_is_one_line(copy):
    (document,) = re.findall(r"`(\{.*), \.\.\.\]\}`", PAGE)
    trip = json.loads(document + "]}")
    (sample,) = trip["samples"]
    trip["samples"] = [
        {"t": sample["t"] + 1000 * t, "spd": 3.6 * t, "u": 360 - t / 10, "i": 2 * t + t**2 / 10}
        for t in range(100)
    ]
    (copy / "trip.json").write_text(json.dumps(trip))
    apply(copy, block(APP, "diff"), "--unidiff-zero")
    ended = run(copy, "python", "-m", "evpinn_ros", "info", "trip.json")
    assert "'u', V, as in logs with a column 'spd', 'u', 'i'" in ended.stdout, ended.stderr
    assert "positive while it discharges" in ended.stdout
