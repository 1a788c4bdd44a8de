"""Tasks, methods of anybody's, and cars by SUMO and FASTSim."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.fastsim_peer import fastsim_version
from benchmarks.unseen import run
from benchmarks.unseen.drives import load_car
from benchmarks.unseen.fastsim_cars import FastsimDrive, fastsim_readings, fastsim_truth
from benchmarks.unseen.sumo_cars import simulate_sumo, sumo_is_there, sumo_truth
from evpinn_ros.core.signals.readings import BatteryReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.physics import GRAVITY

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "methods" / "least_squares.py"
MINE = '''
"""A method of somebody else."""
from benchmarks.unseen.method import Prediction
from evpinn_ros.core.signals.readings import SpeedReading

class Flat:
    """Ten kilowatts, always."""

    def __init__(self, vehicle):
        """Take nothing from it."""

    def add_reading(self, reading):
        """Ten kilowatts."""
        if isinstance(reading, SpeedReading):
            yield Prediction(reading.stamp_ns, 1e4)

    def begin_next_drive(self):
        """Nothing to forget."""

    def combinations(self):
        """Nothing is known."""
        return {}
'''


@pytest.fixture
def folder(tmp_path):
    """A CSV drive of 400 s at 20 kW; a current that never changes is not measured."""
    amperes = 2e4 / 360
    rows = (
        f"{t / 10},{15 + t % 7 / 10},360,{amperes + (t % 2 - 0.5) / 1e3}\n" for t in range(4000)
    )
    path = tmp_path / "drive.csv"
    path.write_text("t_s,speed_mps,voltage_v,current_a\n" + "".join(rows))
    return tmp_path


def test_anybodys_method_is_scored(folder):
    (folder / "mine.py").write_text(MINE)
    task = run.Task(f"{folder / 'drive.csv'}=generic", f"{folder / 'drive.csv'}=generic", "")
    task = task._replace(method=f"{folder / 'mine.py'}:Flat")
    found = run.run_task(task).scores
    assert found["carried"]["gross_mean_percent"] == pytest.approx(50.0, abs=0.1)
    assert found["withheld"]["rmse_w"] == pytest.approx(1e4, rel=1e-6)


def test_the_example_of_a_method_beats_the_prior():
    bags = f"{ROOT / 'bags'}=tesla_model_3_lr"
    names = "prior", f"{EXAMPLE}:LeastSquares"
    prior, mine = (run.run_task(run.Task(bags, bags, name)).scores for name in names)
    for part in ("carried", "withheld"):
        assert mine[part]["gross_mean_percent"] < prior[part]["gross_mean_percent"] / 2


@pytest.mark.skipif(not sumo_is_there(), reason="eclipse-sumo and libsumo are optional")
def test_a_car_by_sumo_drives_and_has_its_truth(monkeypatch):
    monkeypatch.setattr("benchmarks.unseen.sumo_cars.SECONDS", 400)
    readings, trace = simulate_sumo("sumo_i3")
    assert trace.shape == (4000, 4)
    power = [each.power for each in readings if isinstance(each, BatteryReading)]
    assert np.allclose(power, trace[:, 3])
    truth = sumo_truth("sumo_i3", trace, load_vehicle("generic"))
    # 1417 kg and 12.5 kg m^2 at wheels of 0.35 m are 1519 kg that are accelerated.
    assert 1519 / 1.03 < truth["mass_over_eta"] < 1519 / 1.03 / 0.8
    assert truth["p_aux"] == 360.0


def test_the_truth_of_a_trace_is_what_made_its_power():
    """The road load of the vehicle file but for a factor, eta 0.9, mu 0.8, 300 W."""
    vehicle, factor = load_vehicle("generic"), 0.8
    car = vehicle.initial._replace(mass=factor * vehicle.initial.mass, p_aux=300.0)
    area = factor * vehicle.frontal_area * car.c_d
    second = np.arange(1200.0)
    speed, height = 14 + 6 * np.sin(second / 20), 30 * np.sin(second / 130)
    before, after = speed[:-1], speed[1:]
    gained = vehicle.rotating_mass_factor * np.diff(speed**2) / 2 + GRAVITY * np.diff(height)
    drag = 0.6 * area * (before + after) * (before**2 + after**2) / 4
    wheel = car.mass * (gained + car.c_rr * GRAVITY * (before + after) / 2) + drag
    power = np.where(wheel > 0, wheel / 0.9, 0.8 * wheel) + car.p_aux
    power = np.concatenate(([0.0], power))
    trace = FastsimDrive(second, speed, height, power, p_aux=300.0, air_density=1.2)
    assert fastsim_truth([trace], vehicle) == pytest.approx(
        {
            "mass_over_eta": car.mass / 0.9,
            "regeneration": 0.9 * 0.8,
            "rolling_over_eta": car.c_rr * car.mass / 0.9,
            "drag_area_over_eta": area / 0.9,
            "p_aux": 300.0,
        },
        rel=5e-3,  # the vehicle file counts a little in twenty minutes
    )
    readings = next(fastsim_readings([trace]))
    found = [each.power for each in readings if isinstance(each, BatteryReading)]
    assert np.allclose(found, power[1:])


@pytest.mark.skipif(fastsim_version() is None, reason="fastsim is optional")
def test_a_car_by_fastsim_drives_and_has_its_truth(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.unseen.fastsim_cars.CYCLES", ("ramp",))
    (tmp_path / "drive_cycles").mkdir()
    rows = (f"{t},{8 - 8 * np.cos(t / 20):.4f}\n" for t in range(400))
    (tmp_path / "drive_cycles" / "ramp.csv").write_text("cycSecs,cycMps\n" + "".join(rows))
    car = load_car(str(tmp_path), "fastsim_zoe")
    assert [round(drive.duration) for drive in car.drives] == [399, 399]
    # 1600 kg, the wheels' inertia beside them.
    assert 1600 / 1.03 < car.truth["mass_over_eta"] < 1600 / 0.8
    assert car.truth["p_aux"] == 250.0
