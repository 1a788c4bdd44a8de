"""`evpinn bench energy` as a person meets it: a short drive twice, real processes, real DDS."""

import json
import math
import subprocess
import sys

from evpinn_ros.share import share_directory


def write_drive(path):
    rows = ["t_s,speed_mps,power_w,elevation_m"]
    for i in range(600):
        speed = 10 + 5 * math.sin(i / 40)
        power = 1000 + speed * (300 + 0.4 * speed**2 + 2000 * 5 / 40 * 10 * math.cos(i / 40))
        rows.append(f"{i / 10},{speed},{power},{100 + i / 100}")
    path.write_text("\n".join(rows) + "\n")


def test_a_short_run_measures_all(tmp_path):
    drives = tmp_path / "drives"
    drives.mkdir()
    for name in ("first.csv", "second.csv"):
        write_drive(drives / name)
    command = [sys.executable, "-m", "evpinn_ros", "bench", "energy", f"{drives}=bmw_i3"]
    done = subprocess.run(
        [*command, "--plans", "10", "--json", str(tmp_path / "out.json")],
        cwd=share_directory(), capture_output=True, text=True, timeout=170,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for line in ("second.csv", "learned model, numpy", "p99"):
        assert line in done.stdout
    found = json.loads((tmp_path / "out.json").read_text())
    (car,) = found["forecasts"]
    assert car["vehicle"] == "bmw_i3" and len(car["drives"]) == 2
    _, _, covered, counted = car["totals"]
    assert counted == 1 and 0 <= covered <= 1
    plans = found["plans"]
    assert plans["plans"] == 10 and plans["points"] == 600
    assert 0 < plans["p50_ms"] <= plans["p99_ms"] <= plans["largest_ms"]
    assert found["library"]["vehicle_file_ms"] > 0
