"""`evpinn bench` as a person runs it."""

import json
import subprocess
import sys

import pytest

from evpinn_ros.common.package_data import share_directory


@pytest.fixture
def bench(tmp_path):
    """Runs a command in a process of its own; gives its output and its JSON."""

    def run(*words):
        command = [sys.executable, "-m", "evpinn_ros", "bench", *words]
        done = subprocess.run(
            [*command, "--json", str(tmp_path / "found.json")],
            cwd=share_directory(), capture_output=True, text=True, timeout=170,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout, json.loads((tmp_path / "found.json").read_text())

    return run
