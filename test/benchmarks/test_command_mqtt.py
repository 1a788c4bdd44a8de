"""`evpinn bench mqtt`: a short run measures what the long one does."""

import json

import pytest
from typer.testing import CliRunner

from benchmarks.mqtt import MOSQUITTO
from evpinn_ros.cli.main import app

pytestmark = pytest.mark.nightly


@pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
def test_a_short_run_measures_delay_and_memory(tmp_path):
    path = tmp_path / "found.json"
    given = ["bench", "mqtt", "--seconds", "25", "--hours", "0.1", "--json", str(path)]
    done = CliRunner().invoke(app, given)
    assert done.exit_code == 0, done.output
    found = json.loads(path.read_text())
    live, (day,) = found["live"], found["day"]
    assert 0 < live["answers"] <= 20 and 100 < live["median_ms"] <= live["most_ms"] < 5000
    assert 0 < live["core_pct"] < 100 and 20 < live["memory_mb"] < 400
    assert day["hours"] == pytest.approx(0.1, abs=0.05) and day["cpu_ms"] > 0
