"""The campaign of faults: a short selection for real, and what makes a fault fail."""

import json
import math
import os
import subprocess
import sys

import pytest

from benchmarks.faults.fault import Fault, FaultEffect, FaultResult
from evpinn_ros.common.package_data import share_directory

SAID = {"state_corrupt": "not a saved state", "speed_nan": "not_finite"}


@pytest.mark.parametrize(
    "name", ["state_corrupt", pytest.param("speed_nan", marks=pytest.mark.nightly)]
)
def test_a_fault_loses_nothing_and_is_named(tmp_path, name):
    """In a process, for a campaign has a ROS network of its own."""
    path = tmp_path / "faults.json"
    words = ("-m", "evpinn_ros", "bench", "faults", "--only", name, "--json", str(path))
    done = subprocess.run(
        [sys.executable, *words], cwd=share_directory(), capture_output=True, text=True,
        timeout=300, env={**os.environ, "COLUMNS": "200"},
    )  # fmt: skip
    (fault,) = json.loads(path.read_text())["faults"]
    assert fault["name"] == name and fault["kept"] and SAID[name] in fault["said"], done.stdout
    assert done.returncode == bool(fault["problem"]), done.stderr  # a busy machine may be slow


@pytest.mark.parametrize(
    ("finding", "problem"),
    [
        (FaultEffect("nothing", True, 4.9, "it is so"), None),
        (FaultEffect("all", False, 0.0, "it is so"), "lost more than the contract states"),
        (FaultEffect("nothing", True, 5.1, "it is so"), "took more than 5 s"),
        (FaultEffect("nothing", True, math.inf, "it is so"), "took more than 5 s"),
        (FaultEffect("nothing", True, math.nan, "it is so"), "took more than 5 s"),
        (FaultEffect("nothing", True, 0.0, None), "not named in diagnostics"),
    ],
)
def test_a_fault_fails_for_what_it_costs_or_hides(finding, problem):
    fault = Fault("x", "x", "x", lambda _: finding)
    assert FaultResult(fault, finding).problem == problem
