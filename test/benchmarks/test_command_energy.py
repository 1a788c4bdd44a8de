"""`evpinn bench energy` as a person meets it: a short drive twice, real processes, real DDS."""

import json
import math
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from benchmarks import energy_integration, energy_library
from evpinn_ros.cli.main import app
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.simulation.drive import DriveKind

pytestmark = pytest.mark.nightly


def write_drive(path, seconds=60):
    rows = ["t_s,speed_mps,power_w,elevation_m"]
    for i in range(seconds * 10):
        speed = 10 + 5 * math.sin(i / 40)
        power = 1000 + speed * (300 + 0.4 * speed**2 + 2000 * 5 / 40 * 10 * math.cos(i / 40))
        rows.append(f"{i / 10},{speed},{power},{100 + i / 100}")
    path.write_text("\n".join(rows) + "\n")


def measure(folder, *arguments):
    """Run the command in this process; gives its output and its JSON."""
    out = folder / "out.json"
    done = CliRunner().invoke(app, ["bench", "energy", *arguments, f"--json={out}"])
    assert done.exit_code == 0, done.output
    return done.output, json.loads(out.read_text())


def test_plans_over_dds(tmp_path):
    write_drive(tmp_path / "drive.csv")
    command = [sys.executable, "-m", "evpinn_ros", "bench", "energy", f"{tmp_path}=bmw_i3"]
    done = subprocess.run(
        [*command, "--part=plans", "--plans", "10", "--json", str(tmp_path / "out.json")],
        cwd=share_directory(), capture_output=True, text=True, timeout=170,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "p99" in done.stdout
    found = json.loads((tmp_path / "out.json").read_text())
    plans = found["plans"]
    assert plans["plans"] == 10 and plans["points"] == 600
    assert 0 < plans["p50_ms"] <= plans["p99_ms"] <= plans["largest_ms"]
    assert not found.keys() & {"battery", "counting", "library"}


def test_the_library_alone(tmp_path, monkeypatch):
    """In this process, so that each is timed once."""
    monkeypatch.setattr(energy_library, "REPEATS", 1)
    write_drive(tmp_path / "drive.csv")
    output, found = measure(tmp_path, f"{tmp_path / 'drive.csv'}=bmw_i3", "--part=library")
    assert "learned model, numpy" in output
    assert min(found["library"].values()) > 0


def test_counting_alone(tmp_path, monkeypatch):
    """In this process, so that a day, the silences and the simulated drives can be less."""
    monkeypatch.setattr(energy_integration, "DAY", 60)
    monkeypatch.setattr(energy_integration, "DriveKind", [DriveKind.URBAN])
    monkeypatch.setattr(energy_integration, "SIMULATED_TIME", 120.0)
    monkeypatch.setattr(energy_integration, "STRIDE", 20.0)
    monkeypatch.setattr(energy_integration, "DROPOUT", 20.0)
    write_drive(tmp_path / "drive.csv")
    _, found = measure(tmp_path, f"{tmp_path / 'drive.csv'}=bmw_i3", "--part=counting")
    names = [row["name"] for row in found["counting"]]
    for start in ("drift in 24 h", "quadrature of 10 Hz", "1 Hz with 10% missing", "bmw_i3, "):
        assert any(name.startswith(start) for name in names), start
    assert "bmw_i3, battery dropout of 20 s: median" in names
