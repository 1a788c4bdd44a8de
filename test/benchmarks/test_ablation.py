"""Every part of the core can be left out, is missed by something, and is back afterwards."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.cli.ablation import VARIANTS
from evpinn_ros.cli.main import app

pytestmark = pytest.mark.nightly

URBAN = f"{Path(__file__).parents[2] / 'bags' / 'urban'}=tesla_model_3_lr"
CUT = 20  # interval that begins another drive


def test_the_command(tmp_path):
    file = tmp_path / "found.json"
    command = ["bench", "ablation", "", "--cars", URBAN, "--seeds", "1", "--json", str(file)]
    result = CliRunner().invoke(app, [*command, "--jobs", "1"])
    assert result.exit_code == 0, result.output
    rows = json.loads(file.read_text())
    assert [row["variant"] for row in rows] == [each.name for each in VARIANTS]
    assert all(row["carried_crps"] > 0.0 for row in rows)
