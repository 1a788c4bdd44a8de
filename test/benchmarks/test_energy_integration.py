import time

import pytest

from benchmarks import energy_integration
from benchmarks.energy_integration import integration_rows
from benchmarks.logs import find_logs
from evpinn_ros.energy.meter import Integrator
from evpinn_ros.simulation.drive import DriveKind
from evpinn_ros.simulation.output import write
from evpinn_ros.simulation.simulate import simulate
from evpinn_ros.vehicle.files import load_vehicle

pytestmark = pytest.mark.nightly


def test_figures_that_need_no_data(monkeypatch):
    monkeypatch.setattr(energy_integration, "DAY", 600)  # a whole one: test_quadrature.py
    drift, quadrature, *gaps = integration_rows([], time.thread_time)
    assert drift.name.startswith("drift") and drift.figure <= 1e-6
    assert quadrature.name.startswith("quadrature") and 0.0 < quadrature.figure <= 1e-4
    assert gaps[-1].name.endswith("worst") and 0.0 < gaps[-1].figure <= 0.5


def test_a_drive_without_a_battery_gives_no_figures_of_a_car(tmp_path, monkeypatch):
    monkeypatch.setattr(energy_integration, "DAY", 60)
    monkeypatch.setattr(energy_integration, "simulated_rows", list)
    drive = tmp_path / "drive.csv"
    drive.write_text("t_s,speed_mps,power_w\n" + "".join(f"{t},9.0,\n" for t in range(100)))
    (only,) = integration_rows([find_logs(str(drive), "bmw_i3")], time.thread_time)
    assert only.name.startswith("drift")


def test_a_drive_gives_every_figure_of_a_car(tmp_path, monkeypatch):
    monkeypatch.setattr(energy_integration, "DAY", 60)
    monkeypatch.setattr(energy_integration, "simulated_rows", list)
    monkeypatch.setattr(energy_integration, "STRIDE", 30.0)
    monkeypatch.setattr(energy_integration, "DROPOUT", 30.0)
    vehicle = load_vehicle("tesla_model_3_lr")
    write(simulate(DriveKind.URBAN, vehicle, 100.0, 1), tmp_path / "drive")
    logs = find_logs(str(tmp_path / "drive"), vehicle.key)
    rows = {row.name: row for row in integration_rows([logs], time.thread_time)}
    silent = "tesla_model_3_lr, battery dropout of 30 s"
    assert rows[f"{silent}: median"].cases >= 2
    assert 0.0 < rows[f"{silent}: median"].figure <= rows[f"{silent}: worst"].figure < 50.0
    assert 0.0 <= rows[f"{silent}: in the 90 % band"].figure <= 100.0
    # A battery every 5 s teaches nothing, and nothing was learned before this drive.
    for period, most in ((1, 2.0), (5, 30.0)):
        slow = f"tesla_model_3_lr, battery every {period} s with 10% in gaps"
        network, rule = (rows[f"{slow}, {each.value}: worst"] for each in Integrator)
        assert 0.0 < network.figure < most and network.cases == 1
        assert network.figure == pytest.approx(rule.figure, abs=0.1)
        assert network.figure != rule.figure
