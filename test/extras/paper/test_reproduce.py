"""`evpinn reproduce` on a short drive, as a person runs it."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from evpinn_ros.cli.main import app
from evpinn_ros.core.estimation.state_file import read_state
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.extras.paper import settings
from evpinn_ros.extras.paper.settings import OptimizerName

pytestmark = pytest.mark.nightly

VEHICLE = "tesla_model_3_lr"


@pytest.fixture
def drive(tmp_path):
    time = 0.1 * np.arange(300)
    speed = np.maximum(0.0, 10 + 8 * np.sin(0.4 * time) + 5 * np.sin(1.3 * time))
    power = 900 + speed * (180 + 2400 * np.gradient(speed, 0.1) + 0.4 * speed**2)
    lines = [f"{t:.1f},{v:.5f},{p:.1f}" for t, v, p in zip(time, speed, power, strict=True)]
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(["t_s,speed_mps,power_w", *lines]) + "\n")
    return path


def run(*arguments):
    ended = CliRunner().invoke(app, [str(a) for a in arguments], catch_exceptions=False)
    assert ended.exit_code == 0, ended.output
    return ended.output


@pytest.fixture
def quick(monkeypatch):
    """A look that is quicker still."""
    monkeypatch.setattr(settings, "QUICK_ENERGY_EPOCHS", 30)
    monkeypatch.setitem(settings.QUICK_EPOCHS, OptimizerName.GAUSS_NEWTON, 15)


def test_everything_the_issue_names_is_written(quick, drive, tmp_path):
    out = tmp_path / "out"
    options = ("--vehicle", VEHICLE, "--quick", "--out", out)
    text = run("reproduce", drive, *options)
    assert "QUICK LOOK: gauss_newton, 15 epochs" in text
    assert "Shortened: gauss_newton in place of the paper's 10000 epochs of adam" in text
    for title in ("Table II:", "Table IV", "Table V", "Table VI", "baseline: line in time"):
        assert title in text
    results = json.loads((out / "results.json").read_text())
    assert results["settings"]["epochs"] == 15
    assert len(results["verdict"]) == 5
    for finding in results["verdict"]:  # it stands before the tables
        line = f"{finding['answer'].upper()}. {finding['claim']}: {finding['measured']}."
        assert 0 <= text.index(line) < text.index("Table II:")
    assert [row["epoch"] for row in results["power_losses"]["random"]][-1] == 15
    assert set(results["parameters"]) == {"eta", "mu", "mass", "c_rr", "c_d"}
    page = (out / "report.html").read_text()
    assert "QUICK LOOK" in page and page.count("data:image/png;base64") == 8
    assert "http://" not in page and "https://" not in page
    assert load_vehicle(out / "vehicle.yaml").initial.mass > 0
    assert read_state(out / "state.json")["vehicle"] == VEHICLE
    again = run("reproduce", drive, *options)
    tables = text.index("QUICK LOOK")  # before it stands how long it took
    assert again[again.index("QUICK LOOK") :] == text[tables:]
    scores, replay = tmp_path / "scores.json", ("replay", drive, *options[:2], "--mode", "paper")
    run(*replay, "--warm-up", 5, "--state", out / "state.json", "--metrics", scores)
    assert json.loads(scores.read_text())["power"]["rmse_w"] > 0
    run("check-params", out / "vehicle.yaml")
