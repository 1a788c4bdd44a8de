"""The campaign of faults: a short selection for real, and what makes a fault fail."""

import json
import math
import os
import subprocess
import sys

import pytest

from benchmarks.faults.fault import Fault, FaultEffect, FaultResult
from evpinn_ros.common.package_data import share_directory

SHORT = ("speed_nan", "state_corrupt")


def bench(*arguments):
    """`evpinn bench faults` in a process, with a ROS network of its own."""
    command = [sys.executable, "-m", "evpinn_ros", "bench", "faults", *map(str, arguments)]
    return subprocess.run(
        command,
        cwd=share_directory(),
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "COLUMNS": "200"},
    )


def test_some_faults_lose_nothing_and_are_named(tmp_path):
    path = tmp_path / "faults.json"
    only = [word for name in SHORT for word in ("--only", name)]
    done = bench(*only, "--json", path)
    found = {fault["name"]: fault for fault in json.loads(path.read_text())["faults"]}
    assert list(found) == list(SHORT)
    assert all(fault["kept"] and fault["said"] for fault in found.values()), done.stdout
    assert "not_finite" in found["speed_nan"]["said"]
    assert "not a saved state" in found["state_corrupt"]["said"]
    failed = [fault for fault in found.values() if fault["problem"]]  # a busy machine may be slow
    assert done.returncode == bool(failed), done.stderr


def test_a_fault_of_no_such_name_is_told():
    done = bench("--only", "earthquake")
    assert done.returncode == 1 and "no fault named 'earthquake'" in done.stderr


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
