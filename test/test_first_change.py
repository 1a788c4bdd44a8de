"""The first change that CONTRIBUTING.md walks through, made in a copy of the repository."""

from pathlib import Path
import re
import shutil
import subprocess
import sys
from textwrap import dedent

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    """The one block of code in this language, without its indentation."""
    (found,) = re.findall(rf"^   ```{language}\n(.*?)^   ```$", PAGE, re.DOTALL | re.MULTILINE)
    return dedent(found)


@pytest.fixture
def copy(tmp_path) -> Path:
    """The package, and the test that the walkthrough writes."""
    # With what is compiled, which holds for files of the same time and takes seconds to make.
    skipped = shutil.ignore_patterns("*.npz")
    shutil.copytree(ROOT / "evpinn_ros", tmp_path / "evpinn_ros", ignore=skipped)
    (tmp_path / "config").symlink_to(ROOT / "config")
    page = ROOT / "test" / "logs" / "test_columns.py"
    text = page.read_text(encoding="utf-8") + "\n\n" + block("python")
    (tmp_path / "test_columns.py").write_text(text, encoding="utf-8")
    return tmp_path


def passes(folder: Path) -> bool:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "danish"]
    done = subprocess.run(
        [*command, "test_columns.py"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert "1 passed" in done.stdout or "1 failed" in done.stdout, done.stdout + done.stderr
    return done.returncode == 0


@pytest.mark.nightly
def test_the_test_fails_before_the_change_and_passes_after_it(copy):
    assert not passes(copy)
    diff = dedent(block("diff")).encode()
    subprocess.run(["git", "apply", "-"], input=diff, cwd=copy, check=True)
    assert passes(copy)


def test_a_term_is_two_lines(copy):
    diff = block("patch").encode()
    subprocess.run(["git", "apply", "--unidiff-zero", "-"], input=diff, cwd=copy, check=True)
    done = subprocess.run(
        [sys.executable, "-c", block("py")], cwd=copy, capture_output=True, text=True, check=False
    )
    assert done.stdout == "J for 1 N/(m/s): 800.0\n", done.stderr
