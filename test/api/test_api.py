"""The package from Python: the command's numbers to the bit, as DataFrames, without ROS."""

import ast
import csv
import doctest
import inspect
import json
from pathlib import Path
import subprocess
import sys

import numpy as np
import pandas as pd
import polars
import pytest
from typer.testing import CliRunner

import evpinn_ros as ev
import evpinn_ros.api
from evpinn_ros.api import estimator, plan, recordings
from evpinn_ros.cli.main import app
from evpinn_ros.core.estimation.state_file import read_state
from evpinn_ros.core.estimation.states import State
from evpinn_ros.replays.forecasts import known_model
import evpinn_ros.replays.run  # from here on the room `replay` is an attribute of the package

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
URBAN, CAR = ROOT / "bags" / "urban", "tesla_model_3_lr"
SPAN = {"duration": 90.0, "warm_up": 30.0, "withhold_battery_after": 60.0}


@pytest.fixture(scope="module")
def result() -> ev.Result:
    return ev.replay(URBAN, CAR, **SPAN)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of a made-up car at 10 Hz, with a hill."""
    time = np.arange(600) / 10
    speed = np.maximum(0.0, 8 + 9 * np.sin(0.15 * time) + np.sin(0.9 * time))
    power = 900 + speed * (180 + 2400 * np.gradient(speed, 0.1) + 0.4 * speed**2)
    columns = {
        "t_s": time,
        "speed_mps": speed,
        "voltage_v": 350 - power / 1e4,
        "current_a": power / (350 - power / 1e4),
        "elevation_m": 5 * np.sin(np.cumsum(speed) / 1000),
        "ambient_c": np.full(600, 12.0),
    }
    path = tmp_path_factory.mktemp("api") / "drive.csv"
    pd.DataFrame(columns).round(4).to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def learned(table, tmp_path_factory) -> tuple[ev.Result, Path]:
    """That minute replayed, and the state that it left."""
    state = tmp_path_factory.mktemp("learned") / "car.json"
    return ev.replay(table, state=state), state


def without_timing(metrics: dict) -> dict:
    plain = json.loads(json.dumps(metrics, allow_nan=False))
    del plain["replay"], plain["updates"]["p50_ms"], plain["updates"]["p99_ms"]
    return plain


def test_numbers_are_the_commands_to_the_bit(result, tmp_path):
    metrics = tmp_path / "found.json"
    options = [f"--{name.replace('_', '-')}={value}" for name, value in SPAN.items()]
    words = ["replay", str(URBAN), "--vehicle", CAR, "--metrics", str(metrics), *options]
    ended = CliRunner().invoke(app, words, catch_exceptions=False)
    assert ended.exit_code == 0, ended.output
    assert without_timing(result.metrics) == without_timing(json.loads(metrics.read_text()))


def test_frames_hold_what_the_scores_are_of(result):
    after_warm_up = (result.power.index > 30.0) & (result.power.index <= 60.0)
    known = result.power[after_warm_up]
    for name, score in (("smoothed", "power"), ("predicted", "power_now")):
        error = known[f"{name}_w"] - known["measured_w"]
        assert np.sqrt((error**2).mean()) == pytest.approx(result.metrics[score]["rmse_w"])
    withheld = result.energy[result.energy.index > 60.0]
    spent = withheld.iloc[-1] - withheld.iloc[0]
    for name in ("measured_j", "predicted_j", "rknn_j"):
        joules = result.metrics["withheld"]["energy"][name]
        assert spent[name] == pytest.approx(joules, rel=0.01)  # but for the edges
    assert result.parameters["value"].to_dict() == {
        name: estimate["value"] for name, estimate in result.metrics["parameters"].items()
    }
    last = result.learning.iloc[-1]
    assert last["mass", "std"] == result.parameters.loc["mass", "std"]
    parts = result.breakdown["kwh"].drop(["measured", "regained"])
    assert parts.sum() == pytest.approx(result.breakdown.loc["measured", "kwh"])
    (forecast,) = result.forecasts.itertuples()
    assert forecast.measured_j == pytest.approx(
        result.energy["measured_j"].iloc[-1], rel=0.05
    )  # whole seconds
    for frame in (result.power, result.energy, result.learning):
        assert frame.index.name == "t_s" and frame.index.is_monotonic_increasing


def test_pandas_is_loaded_with_the_first_frame(table):
    code = f"""
import sys
import evpinn_ros as ev
result = ev.replay({str(table)!r})
assert "pandas" not in sys.modules
assert len(result.power) and "pandas" in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_a_drive_without_a_battery_has_frames_of_what_is_known(table, tmp_path):
    rows = pd.read_csv(table)[["t_s", "speed_mps"]].iloc[:100].assign(power_w=np.nan)
    rows.to_csv(tmp_path / "speed.csv", index=False)
    result = ev.replay(tmp_path / "speed.csv")
    assert result.power["measured_w"].isna().all() and result.power["smoothed_w"].notna().any()
    assert result.energy["measured_j"].isna().all() and result.breakdown["kwh"].isna().all()
    assert len(result.parameters) == 6 and result.forecasts.empty


def test_samples_one_by_one_give_what_a_replay_gives(table, learned, tmp_path):
    result, car = learned[0], ev.Estimator()
    with table.open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    predicted = result.power["predicted_w"].dropna()
    now = filter(None, (car.add(**row) for row in rows))
    live = pd.Series({prediction.t_s: prediction.power_w for prediction in now})
    np.testing.assert_allclose(live, predicted, rtol=1e-9)
    car._chain.estimator.finish()  # a replay knows where its drive ends
    pd.testing.assert_frame_equal(car.parameters, result.parameters)
    pd.testing.assert_frame_equal(car.breakdown, result.breakdown)
    plan = pd.read_csv(table)
    pd.testing.assert_frame_equal(ev.forecast(plan, car), ev.forecast(plan, result))
    car.save(tmp_path / "car.json")
    again = ev.Estimator(state=tmp_path / "car.json")
    car._chain.begin_next_drive()  # as the saved car has
    assert again.parameters.loc["mass", "value"] == car.parameters.loc["mass", "value"]


@pytest.mark.parametrize("seconds", [140, 187])
def test_a_live_car_and_its_file_give_one_energy_and_one_sigma(tmp_path, seconds):
    """Of another drive; the file is of the car with all that it was given, not of before."""
    live = ev.Estimator("bmw_i3")
    for second in range(seconds):
        speed = 14.0 + 8.0 * np.sin(second / 4)
        watts = 12e3 + 3000.0 * speed * np.cos(second / 4)
        live.add(second, speed, 350.0, watts / 350.0, ambient_c=-5.0)
    live.save(tmp_path / "car.json")
    saved = ev.Estimator("bmw_i3", state=tmp_path / "car.json")
    plan = {"length_km": [50.0], "speed_kmh": [90.0]}
    conditions = ({}, {"temperature_c": -5.0}, {"heating_w": 500.0})
    for given in conditions:
        rested = [ev.forecast(plan, car, stood_h=2.0, **given) for car in (live, saved)]
        pd.testing.assert_frame_equal(*rested, check_exact=True)
        in_drive = ev.forecast(plan, live, **given)
        assert in_drive["sigma_j"].iloc[-1] != rested[0]["sigma_j"].iloc[-1]
    live.begin_next_drive()
    for given in conditions:
        both = (ev.forecast(plan, car, **given) for car in (live, saved))
        pd.testing.assert_frame_equal(*both, check_exact=True)


def test_a_state_that_is_not_there_is_an_error_and_no_new_car():
    """A name with a slip of the pen would begin at the vehicle's priors, and say nothing."""
    with pytest.raises(ev.InputError, match=r"typo\.json: no such file"):
        ev.Estimator(state="typo.json")


def test_a_state_keeps_what_was_learned_of_the_battery(tmp_path):
    """Capacity and voltage: the charge after a plan is that of before, but for cold tyres."""
    time = np.arange(600.0)
    current = 180.0 + np.sin(time)
    charge = 90.0 - 100 * 360.0 * np.cumsum(current) / (40 * 3.6e6)  # 40 kWh: half of the file
    columns = {"t_s": time, "speed_mps": 25.0 + np.sin(time) / 9, "voltage_v": 360 + time / 1e3}
    columns |= {"current_a": current, "soc_pct": np.round(2 * charge) / 2}
    car = ev.replay(pd.DataFrame(columns), CAR, state=tmp_path / "car.json", warm_up=60.0)
    assert car.account.gauge.capacity.value < 55 * 3.6e6
    again = ev.Estimator(CAR, state=tmp_path / "car.json")
    assert again.account.gauge.capacity == car.account.gauge.capacity
    time = np.arange(0.0, 601.0)
    plan = {"t_s": time, "speed_mps": np.minimum(25.0, 1.25 * time)}
    ends = [
        ev.forecast(plan, known_car, charge_pct=80.0).iloc[-1] for known_car in (car, again, CAR)
    ]
    drops = [80.0 - end["charge_pct"] for end in ends]
    assert drops[1] == pytest.approx(drops[0], rel=0.1) and drops[1] > 1.3 * drops[2]
    assert again.account.since_reset().distance == 0.0  # another trip
    assert again.account.lifetime().distance == pytest.approx(car.account.lifetime().distance)


def test_a_state_is_carried_from_drive_to_drive(table, learned, tmp_path):
    first, before = learned
    state = tmp_path / "car.json"
    state.write_bytes(before.read_bytes())
    second = ev.replay(table, state=state)
    drives = [read_state(path)["learned"]["learner"]["car"]["drives"] for path in (before, state)]
    assert drives[1] > drives[0] and read_state(state)["learned"]["vehicle"] == "generic"
    assert (first.parameters["value"] != second.parameters["value"]).any()
    with pytest.raises(ev.InputError, match="saved for"):
        ev.replay(table, CAR, state=state)


def test_the_charge_of_a_car_that_nothing_was_learned_of_is_by_its_capacity():
    trip = {"t_s": [0.0, 400.0], "speed_mps": [20.0, 20.0]}
    assert ev.forecast(trip, CAR)["charge_pct"].isna().all()
    end = ev.forecast(trip, CAR, charge_pct=50.0).iloc[-1]
    share = end["energy_j"] / ev.load_vehicle(CAR).battery_capacity
    assert end["charge_pct"] == pytest.approx(50.0 - 100 * share)
    assert end["charge_sigma_pct"] > 0
    assert ev.forecast(trip, charge_pct=50.0)["charge_pct"].isna().all()  # a car of any battery


def test_a_learner_without_a_model_answers_by_its_parameters(result):
    car, final = result.vehicle, result.replayed.drive.final
    by_parameters = known_model(None, final, car).car
    assert by_parameters.mean[State.MASS_OVER_ETA] == final.identifiable.mass_over_eta
    by_file = known_model(None, None, car).car
    assert by_file.mean[State.MASS_OVER_ETA] == pytest.approx(car.initial.mass / car.initial.eta)


def test_trips_of_a_day_are_results_that_learn_from_each_other(table, tmp_path):
    trip = pd.read_csv(table).iloc[:540]
    later = trip.assign(t_s=trip["t_s"] + 1800.0)
    first, second = ev.replay_trips(pd.concat([trip, later]), warm_up=10.0)
    assert [len(result.power) > 100 for result in (first, second)] == [True, True]
    alone = ev.replay(trip, warm_up=10.0)
    assert first.parameters.equals(alone.parameters)
    begins = [result.learning["mass", "value"].iloc[0] for result in (first, second)]
    assert begins[0] != begins[1], "the second begins with what the first taught"
    assert first.account is not second.account
    for name, rows in (("first", trip), ("second", later)):
        rows.to_csv(tmp_path / f"{name}.csv", index=False)
    of_folder = ev.replay_trips(tmp_path, warm_up=10.0)
    assert [
        r.parameters.equals(t.parameters) for r, t in zip(of_folder, (first, second), strict=True)
    ] == [*(True, True)]
    with pytest.raises(ev.InputError, match="2 recordings"):
        ev.replay(tmp_path)
    with pytest.raises(ev.InputError):
        ev.replay_trips(table, mode="none")


def test_a_table_of_pandas_or_polars_is_a_drive(table):
    frame = pd.read_csv(table).iloc[:150]
    times = pd.to_timedelta(frame["t_s"], unit="s")
    tables = frame, frame.set_index("t_s"), frame.drop(columns="t_s").set_index(times)
    polars_table = polars.from_dict({name: frame[name].tolist() for name in frame})
    rows = len(frame)
    other_kinds = polars_table.with_columns(
        polars.duration(milliseconds=polars.col("t_s") * 1e3).alias("t_s"),
        polars.Series("cells", [[3.7, 3.8]] * rows),
        polars.Series("place", [{"lat": 1.0}] * rows),
        polars.Series("raw", [b"7e8"] * rows),
        polars.Series("note", [object()] * rows, polars.Object),
    )
    first, *others = (
        without_path(ev.replay(drive_table, warm_up=5.0))
        for drive_table in (*tables, polars_table, other_kinds)
    )
    assert first["input"]["samples"] > 140 and others == [first] * 4


def without_path(result: ev.Result) -> dict:
    metrics = without_timing(result.metrics)
    del metrics["input"]["path"]
    return metrics


def test_what_is_declared_is_there_and_documented():
    stub = ast.parse((ROOT / "evpinn_ros" / "__init__.pyi").read_text())
    typed = {name.asname for node in stub.body for name in getattr(node, "names", ())}
    assert typed | {"__version__"} == set(ev.__all__) == {*dir(ev)}
    assert {*evpinn_ros.api.__all__, "__version__"} == set(ev.__all__)
    for name in evpinn_ros.api.__all__:
        assert inspect.getdoc(getattr(evpinn_ros.api, name))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = ev.nothing


def test_importing_the_package_is_cheap(loads_without):
    loads_without("import evpinn_ros", "numpy", "pandas", "typer", "rclpy")
    slow = ("matplotlib", "pandas", "polars", "scipy.ndimage", "torch", "rclpy")
    loads_without("import evpinn_ros.cli.main, evpinn_ros.cli.replay", *slow)
    loads_without("import evpinn_ros; evpinn_ros.Estimator", "matplotlib", "rclpy", "torch")


@pytest.mark.parametrize("module", [estimator, plan, recordings], ids=lambda m: m.__name__)
def test_examples_in_docstrings_run(module, monkeypatch):
    monkeypatch.chdir(ROOT)
    failed, tried = doctest.testmod(module)
    assert tried and not failed
