"""The two changes that CONTRIBUTING.md walks through, made in a copy of the repository."""

from collections.abc import Iterator
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
LEFT_OUT = shutil.ignore_patterns(".*", "build", "install", "log", "out", "*.egg-info")


def block(language: str) -> str:
    """The one block of code in this language, without its indentation."""
    (text,) = re.findall(rf"^   ```{language}\n(.*?)^   ```$", PAGE, re.DOTALL | re.MULTILINE)
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
    page.write_text(f"{text}\n\n{block('python')}", encoding="utf-8")
    return copy


@pytest.mark.build
def test_the_test_fails_before_the_change_and_passes_after_it(with_new_test):
    command = shlex.split(re.search(r"`(\.venv/bin/pytest [^`]+)`", PAGE)[1])
    before = run(with_new_test, *command)
    assert "1 failed" in before.stdout, before.stdout + before.stderr
    apply(with_new_test, block("diff"))
    after = run(with_new_test, *command)
    assert after.returncode == 0 and "1 passed" in after.stdout, after.stdout + after.stderr


@pytest.fixture
def with_term(copy) -> Path:
    apply(copy, block("patch"), "--unidiff-zero")
    return copy


@pytest.mark.build
def test_a_term_is_two_lines(with_term):
    ended = run(with_term, "python", "-c", block("py"))
    assert ended.stdout == "J for 1 N/(m/s): 800.0\n", ended.stderr
