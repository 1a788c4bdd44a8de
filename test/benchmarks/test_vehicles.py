"""Priors before driving: judged by cars that were withheld from them."""

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import vehicles
from evpinn_ros.cli.main import app
from evpinn_ros.vehicle.certified import AIR_DENSITY, certified_cars
from evpinn_ros.vehicle.files import load_vehicle

pytestmark = pytest.mark.slow

TAYCAN = "porsche_taycan_turbo_cross_turismo_2022"


def test_no_car_is_told_of_its_own_model(monkeypatch):
    """With every model but the Taycans removed there is nobody to tell of them."""
    populations = []
    monkeypatch.setattr(vehicles, "population", lambda cars: populations.append({*cars}) or ANY)
    ANY = vehicles.of_vehicle(load_vehicle("generic"))
    list(vehicles.prior_errors({}))
    cars = certified_cars()
    own = [group for group in populations if cars[TAYCAN] not in group]
    assert len(own) == 1 and not any("Taycan" in car.name for car in own[0])
    assert len(own[0]) == len(cars) - sum("Taycan" in car.name for car in cars.values())


def test_the_population_of_other_models_is_honest_where_a_sedan_is_not():
    sedan = load_vehicle("tesla_model_3_lr")
    found = {(row.name, row.speed): row for row in vehicles.prior_errors({"sedan": sedan})}
    for speed in vehicles.SPEEDS:
        others = found["population of the other models", speed]
        assert others.error < 0.2 and 0.85 < others.inside <= 1.0
        assert others.after < others.error
        assert others.inside > found["sedan", speed].inside


def test_a_cycle_at_constant_speed_costs_its_road_load(tmp_path):
    """By hand: force over eta, cold tyres, the turning drivetrain, the load, and the charger."""
    rows = "".join(f"{second},20.0\n" for second in range(600))
    for name in vehicles.CYCLES:
        (tmp_path / f"{name}.csv").write_text(f"cycSecs,cycMps\n{rows}")
    car, vehicle = certified_cars()[TAYCAN], load_vehicle(TAYCAN)
    start, speed = vehicle.initial, 20.0
    drag = 0.5 * AIR_DENSITY * start.c_d * vehicle.frontal_area * speed**2
    cold = 0.15 * 1200.0 / 600.0 * (1.0 - math.exp(-600.0 / 1200.0))  # mean over 600 s
    force = start.mass * 9.80665 * start.c_rr * (1.0 + cold) + drag
    losses = (
        150.0 * (0.5 + 0.5 * speed / 10.0) + 200.0 * (force / start.mass) ** 2
    )  # turning, and by force
    power = force * speed / start.eta + start.p_aux + losses
    expected = power / speed / 3.6 / (1.0 - vehicles.CHARGING_LOSS)
    for each in vehicles.cycle_energies(tmp_path, car, vehicle):
        assert each.forecast == pytest.approx(expected, rel=0.005)
        assert each.error == pytest.approx(expected / each.certified - 1.0, abs=0.02)


def test_the_command(tmp_path):
    done = CliRunner().invoke(app, ["bench", "vehicles", "--json", str(tmp_path / "b.json")])
    assert done.exit_code == 0, done.output
    rows = json.loads((tmp_path / "b.json").read_text())["beliefs"]
    assert {row["name"] for row in rows} >= {"generic", "population of the other models"}
    assert np.isfinite([row["error"] for row in rows]).all()
