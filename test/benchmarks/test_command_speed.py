"""`evpinn bench speed` as a person meets it: real processes, real DDS."""

import json
import subprocess
import sys

import pytest

from evpinn_ros.common.package_data import share_directory

pytestmark = pytest.mark.nightly


def test_forecasts_in_the_library_and_over_dds(tmp_path):
    command = [sys.executable, "-m", "evpinn_ros", "bench", "speed", "--plans", "10"]
    done = subprocess.run(
        [*command, "--json", str(tmp_path / "out.json")],
        cwd=share_directory(), capture_output=True, text=True, timeout=170,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "learned model, numpy" in done.stdout and "p99" in done.stdout
    found = json.loads((tmp_path / "out.json").read_text())
    assert min(found["library"].values()) > 0
    plans = found["plans"]
    assert plans["plans"] == 10 and plans["points"] == 600
    assert 0 < plans["p50_ms"] <= plans["p99_ms"] <= plans["largest_ms"]
