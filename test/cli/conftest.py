"""The command in this process, which need not load everything again for each run."""

from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
import os
from pathlib import Path
import shlex
import subprocess
from subprocess import CompletedProcess
import sys

import pytest

from evpinn_ros.cli.console import results
from evpinn_ros.cli.main import main

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


def run_here(*arguments: object, cwd: Path, columns: int = 100) -> CompletedProcess[str]:
    """What `evpinn` does in a folder: its exit code, and what it writes for so many columns."""
    out, err = StringIO(), StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        redirect_stdout(out),
        redirect_stderr(err),
        pytest.raises(SystemExit) as ended,
    ):
        patch.chdir(cwd)
        patch.setenv("COLUMNS", str(columns))
        patch.setattr(sys, "argv", ["evpinn", *map(str, arguments)])
        patch.setattr(results, "_width", columns)
        patch.setattr(results, "stderr", False)
        main()
    return CompletedProcess(arguments, ended.value.code or 0, out.getvalue(), err.getvalue())


def run_on_a_full_disk(kilobytes: int, *arguments: object, cwd: Path) -> CompletedProcess[str]:
    """What `evpinn` does where no file can be larger than so much: as on a disk that is full."""
    # -B: a module's code cut short would be imported by the next process.
    command = shlex.join([sys.executable, "-B", "-m", "evpinn_ros", *map(str, arguments)])
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    script = ["bash", "-c", f"ulimit -f {kilobytes}; exec {command}"]
    return subprocess.run(
        script, cwd=cwd, env=environment, capture_output=True, text=True, timeout=150
    )


@pytest.fixture(scope="session")
def on_a_full_disk() -> Callable[..., CompletedProcess[str]]:
    return run_on_a_full_disk


@pytest.fixture(scope="session")
def evpinn() -> Callable[..., CompletedProcess[str]]:
    return run_here
