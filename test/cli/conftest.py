"""The command in this process, which need not load everything again for each run."""

from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from subprocess import CompletedProcess
import sys

import pytest

from evpinn_ros.cli.console import results
from evpinn_ros.cli.main import main


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


@pytest.fixture(scope="session")
def evpinn() -> Callable[..., CompletedProcess[str]]:
    return run_here
