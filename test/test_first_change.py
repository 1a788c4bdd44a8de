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


@pytest.mark.nightly
def test_after_the_first_change_the_tests_of_its_folder_pass(with_new_test):
    apply(with_new_test, block("diff"))
    for command in ("ruff check", "pytest --quick --hypothesis-profile=quick test/logs"):
        ended = run(with_new_test, *shlex.split(command))
        assert ended.returncode == 0, ended.stdout + ended.stderr


@pytest.fixture
def with_term(copy) -> Path:
    apply(copy, block("patch"), "--unidiff-zero")
    return copy


@pytest.mark.build
def test_a_term_is_two_lines(with_term):
    ended = run(with_term, "python", "-c", block("py"))
    assert ended.stdout == "J for 1 N/(m/s): 800.0\n", ended.stderr


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_with_a_term_the_core_passes_and_what_changes_is_what_the_page_says(with_term):
    files = {path: path.read_bytes() for path in (*with_term.glob("docs/**/*.md"),)}
    core, generate, golden = (
        run(with_term, "sh", "-c", line) for line in block("sh").splitlines()
    )
    assert core.returncode == 0 and " passed" in core.stdout, core.stdout
    assert generate.returncode == 0, generate.stderr
    changed = {path.name for path, old in files.items() if path.read_bytes() != old}
    assert changed == {"states.md", "one_interval.md"}
    assert golden.returncode == 0, golden.stderr
    counts = dict(re.findall(r"^(\w+\.csv): \d+ numbers, (\d+) changed$", golden.stdout, re.M))
    assert {name for name, count in counts.items() if count != "0"} == {
        "urban_hybrid.csv",
        "highway_hybrid.csv",
    }
    topics = set(re.findall(r"^  \('([^']+)'", golden.stdout, re.M))
    may, may_not = re.search(r"may change are (.+?)\. If (.+?) changes,", PAGE, re.S).groups()
    assert not topics & {*re.findall(r"`([^`]+)`", may_not)}
    allowed = re.findall(r"`([^`]+?)(?:\.\.\.)?`", may)
    assert all(topic.startswith(tuple(allowed)) for topic in topics), topics
    ended = run(
        with_term,
        "pytest",
        "-q",
        "test/replays/test_golden.py",
        "test/core/estimation/test_published.py",
    )
    assert ended.returncode == 0, ended.stdout
