"""`evpinn forecast`: plans in files of any kind, with the car of a state file."""

import json
import re

import numpy as np
import pandas as pd
import pytest

import evpinn_ros as ev
from test.conftest import ROOT
from test.logs.plans import samples
from test.logs.plans.test_table import LEGS
from test.logs.plans.test_track import CLOCK, gpx

CAR = "tesla_model_3_lr"
URBAN = ROOT / "bags" / "urban"
SLOW = "t_s,speed_mps,elevation_m\n0,0,0\n15,20,0\n400,20,60\n420,0,60\n"
FAST = "t_s,speed_mps,elevation_m\n0,0,0\n20,28,0\n270,28,60\n300,0,60\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plans")
    (folder / "slow.csv").write_text(SLOW)
    (folder / "fast.csv").write_text(FAST)
    car = ev.Estimator(CAR)
    for second in range(90):
        speed = abs(second % 40 - 20.0)
        car.add(second, speed, 360.0, 2 + 2 * speed if second % 40 >= 20 else -speed)
    car.save(folder / "car.json")
    return folder


def test_the_command_is_the_call_to_the_bit(evpinn, folder):
    given = ("--vehicle", CAR, "--state", "car.json", "--charge", 80)
    ended = evpinn("forecast", "slow.csv", "fast.csv", *given, "--json", "f.json", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    assert "as learned in car.json" in ended.stdout
    car = ev.Estimator(CAR, state=folder / "car.json")
    document = json.loads((folder / "f.json").read_text())
    for row in document:
        end = ev.forecast(folder / row["plan"], car, charge_pct=80.0).iloc[-1]
        names = ("distance_m", "energy_j", "sigma_j", "charge_pct", "charge_sigma_pct")
        assert [row[name] for name in names] == [end[name] for name in names]
    more, sigma = (document[1][f"more_than_first_{name}"] for name in ("j", "sigma_j"))
    assert more == pytest.approx(document[1]["energy_j"] - document[0]["energy_j"])
    assert 0 < sigma < document[0]["sigma_j"] + document[1]["sigma_j"]
    assert document[0]["more_than_first_j"] is None


def test_plans_of_every_kind_stand_in_one_table(evpinn, folder):
    """And each is forecast as Python does, whose conditions are those of the command."""
    (folder / "legs.csv").write_text(LEGS)
    (folder / "track.gpx").write_text(gpx())
    (folder / "route.json").write_text(json.dumps(samples.graphhopper(["time"])))
    plans = ("slow.csv", "legs.csv", "track.gpx", "route.json", URBAN)
    given = ("--temperature", -10, "--head-wind", 5, "--charge", 60)
    ended = evpinn("forecast", *plans, "--vehicle", CAR, *given, "--json", "f.json", cwd=folder)
    assert ended.returncode == 0 and ended.stderr == "", ended.stderr
    document = json.loads((folder / "f.json").read_text())
    assert [round(row["distance_m"] / 100) for row in document] == [80, 162, 9, 80, 26]
    level = [line for line in ended.stdout.splitlines() if ": no heights" in line]
    named = {name for line in level for name in line.partition(":")[0].split(", ")}
    names = [str(plan).rpartition("/")[2] for plan in plans]
    rows = zip(names, document, strict=True)
    assert (
        named == {name for name, row in rows if row["without_height_m"]} == {"legs.csv", "urban"}
    )
    conditions = {"temperature_c": -10.0, "head_wind": 5.0, "charge_pct": 60.0}
    for row in document:
        end = ev.forecast(folder / row["plan"], CAR, **conditions).iloc[-1]
        assert row["energy_j"] == end["energy_j"] and row["charge_pct"] == end["charge_pct"]
        mild = ev.forecast(folder / row["plan"], CAR).iloc[-1]
        assert row["energy_j"] > mild["energy_j"]


def test_a_battery_that_does_not_last_is_told_with_its_place(evpinn, folder):
    ended = evpinn("forecast", "slow.csv", "--vehicle", CAR, "--charge", 1, cwd=folder)
    time = np.arange(421.0)  # with a point each second its lines are the same
    lines = pd.read_csv(folder / "slow.csv").set_index("t_s")
    fine = {name: np.interp(time, lines.index, column) for name, column in lines.items()}
    along = ev.forecast({"t_s": time, **fine}, CAR, charge_pct=1.0)
    place = np.interp(0.0, -along["charge_pct"], along["distance_m"]) / 1e3
    assert 1.0 < place < 7.0 and f"empty at {place:.1f} km" in ended.stdout
    assert "by its vehicle file alone" in ended.stdout
    assert "Battery: 75.0 +- 15.0 kWh when full, by its vehicle file." in ended.stdout
    assert "--charge PERCENT" in evpinn("forecast", "slow.csv", cwd=folder).stderr


def test_the_battery_is_that_of_the_state_once_drives_have_shown_it(evpinn, tmp_path):
    time = np.arange(1200.0)
    columns = {"t_s": time, "speed_mps": 25.0 + np.sin(time) / 9, "voltage_v": 360 + time / 1e3}
    columns |= {"current_a": 80.0 + np.sin(time), "soc_pct": np.round(90.0 - time / 50.0, 1)}
    car = ev.replay(pd.DataFrame(columns), CAR, state=tmp_path / "car.json")
    (tmp_path / "slow.csv").write_text(SLOW)
    given = ("--vehicle", CAR, "--state", "car.json", "--charge", 80)
    ended = evpinn("forecast", "slow.csv", *given, cwd=tmp_path)
    held = car.account.gauge.capacity.value / 3.6e6  # 40 kWh, and some of the file's 75
    assert held < 50.0
    same = evpinn("forecast", "slow.csv", *given[2:], cwd=tmp_path)
    assert same.stdout == ended.stdout  # whose car it is says the state
    assert evpinn(
        "forecast", "slow.csv", "--vehicle", "bmw_i3", *given[2:], cwd=tmp_path
    ).returncode
    (full,) = re.findall(r"Battery: ([\d.]+) \+- .* when full, as its drives", ended.stdout)
    assert float(full) == pytest.approx(held, rel=0.01)  # at the power of this plan
    unknown = evpinn("forecast", "slow.csv", "--vehicle", "generic", "--charge", 80, cwd=tmp_path)
    assert "the capacity of the battery" in unknown.stdout


def test_a_drive_is_read_as_the_options_say(evpinn, folder):
    """The second of two cars in one table, whose speed has another unit than its name says."""
    rows = [f"{car},{t},{factor * t}" for car, factor in (("a", 1), ("b", 0.1)) for t in range(91)]
    (folder / "cars.csv").write_text("\n".join(["vehicle id,time [s],v [km/h]", *rows]) + "\n")
    refused = evpinn("forecast", "cars.csv", cwd=folder)
    assert refused.returncode == 1 and "2 cars" in refused.stderr
    options = ("--car", "b", "--column", "speed=v [km/h]:m/s")
    ended = evpinn("forecast", "cars.csv", *options, "--json", "f.json", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    (row,) = json.loads((folder / "f.json").read_text())
    assert row["distance_m"] == pytest.approx(0.1 * 90**2 / 2, rel=1e-3)


def test_units_of_the_us_leave_nothing_metric_and_change_no_number(evpinn, folder):
    given = ("slow.csv", "fast.csv", "--vehicle", CAR, "--charge", 80, "--temperature", 20)
    rows = {}
    for system in ("metric", "us"):
        files = ("--report", f"{system}.html", "--json", f"{system}.json", "--units", system)
        ended = evpinn("forecast", *given, *files, cwd=folder)
        assert ended.returncode == 0, ended.stderr
        rows[system] = json.loads((folder / f"{system}.json").read_text())
    page = (folder / "us.html").read_text()
    seen = re.sub(r"<style>.*?</style>", "", ended.stdout + page, flags=re.DOTALL)
    assert not re.search(r"\bkm\b|km/h|°C|, m\b", seen)
    assert "Model 3 Long Range, by its vehicle file alone" in page and "kWh when full" in page
    assert "mi/kWh" in ended.stdout and "68 °F" in ended.stdout and "mph slower" in page
    assert rows["us"] == rows["metric"]
    miles = rows["us"][0]["distance_m"] / 1609.344
    assert f" {miles:.2f} " in ended.stdout and f"{miles:.1f} mi in" in page


@pytest.mark.parametrize("speed", ["108km/h", "30 m/s", "108", "67.108mph"])
def test_how_far_at_a_speed_with_a_charge_is_one_line(evpinn, tmp_path, speed):
    """Where the battery is empty on a level road, with its band; any unit of speed."""
    given = ("--vehicle", CAR, "--charge", 60, "--temperature", 0)
    ended = evpinn("forecast", "--speed", speed, *given, "--json", "f.json", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    (line,) = (text for text in ended.stdout.splitlines() if "of charge last" in text)
    place, low, high = map(float, re.findall(r"([\d.]+)(?: km:| and|\.$)", line))
    road = {"length_km": [600.0], "speed_kmh": [108.0]}
    along = ev.forecast(road, CAR, charge_pct=60.0, temperature_c=0.0, every_m=500.0)
    charge, sigma = along["charge_pct"], 1.6449 * along["charge_sigma_pct"]
    for shown, level in ((place, charge), (low, charge - sigma), (high, charge + sigma)):
        assert shown == pytest.approx(np.interp(0.0, -level, along["distance_m"] / 1e3), abs=0.6)
    (row,) = json.loads((tmp_path / "f.json").read_text())
    assert row["distance_m"] == pytest.approx(1e3 * place, abs=600.0)
    assert 3.6 * row["distance_m"] / row["duration_s"] == pytest.approx(108.0, rel=1e-4)
    assert row["empty_at_m"] == pytest.approx(row["distance_m"], rel=1e-5)
    assert row["charge_pct"] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("wrong", ["fast", "90 furlongs", "-3km/h", "0", "999km/h"])
def test_a_speed_that_is_none_and_no_plan_at_all_are_refused(evpinn, tmp_path, wrong):
    assert "give a speed with a unit" in evpinn("forecast", "--speed", wrong, cwd=tmp_path).stderr
    assert "give a plan, or --speed" in evpinn("forecast", cwd=tmp_path).stderr


def test_a_track_without_times_takes_a_speed(evpinn, tmp_path):
    """As the reference speed of other planners; times that are there stay."""
    for name, times in (("bare", None), ("timed", CLOCK)):
        (tmp_path / f"{name}.gpx").write_text(gpx(times=times))
    refused = evpinn("forecast", "bare.gpx", cwd=tmp_path)
    assert refused.returncode == 1 and "say --speed 90km/h" in refused.stderr
    given = ("--speed", "36km/h", "--json", "f.json")
    assert evpinn("forecast", "bare.gpx", "timed.gpx", *given, cwd=tmp_path).returncode == 0
    bare, timed = json.loads((tmp_path / "f.json").read_text())
    assert (bare["distance_m"], bare["duration_s"]) == pytest.approx((900.0, 90.0), rel=1e-4)
    assert timed["duration_s"] == 105.0
    python = ev.forecast(tmp_path / "bare.gpx", speed_kmh=36.0)
    assert python["energy_j"].iloc[-1] == bare["energy_j"]


def test_plans_are_named_with_their_suffix(evpinn, folder):
    (folder / "t.csv").write_text(SLOW)
    (folder / "t.gpx").write_text(gpx())
    (folder / "again").mkdir()
    (folder / "again" / "t.csv").write_text(SLOW)
    shown = evpinn("forecast", "t.csv", "t.gpx", cwd=folder).stdout
    assert re.search(r"^ t\.csv .*\n t\.gpx ", shown, re.M)
    shown = evpinn("forecast", "t.csv", "again/t.csv", cwd=folder).stdout
    assert "again/t.csv" in shown
    twice = evpinn("forecast", "t.csv", "t.csv", "--json", "f.json", cwd=folder)
    assert twice.returncode == 0 and len(json.loads((folder / "f.json").read_text())) == 2


@pytest.mark.parametrize("seed", range(4))
def test_a_plan_cut_anywhere_takes_the_same_by_the_command(evpinn, folder, seed):
    """Legs cut in parts of one speed and slope, and rows added on lines of speed."""
    rng = np.random.default_rng(seed)
    legs = rng.uniform((3.0, 40.0, -20.0), (60.0, 120.0, 90.0), (3, 3))
    shares = [rng.dirichlet(np.ones(count)) for count in rng.integers(1, 25, 3)]
    fine = [
        (length * share, speed, climb * share)
        for (length, speed, climb), cuts in zip(legs, shares, strict=True)
        for share in cuts
    ]
    time = np.concatenate(([0.0], np.cumsum(rng.uniform(60.0, 2000.0, 4))))
    speed = rng.uniform(0.0, 33.0, 5)
    times = np.unique(np.concatenate((time, rng.uniform(0.0, time[-1], rng.integers(1, 900)))))
    lines = (time, speed), (times, np.interp(times, time, speed))
    plans = {"legs": (legs.tolist(), fine), "lines": [np.transpose(line) for line in lines]}
    for kind, both in plans.items():
        header = "length_km,speed_kmh,climb_m" if kind == "legs" else "t_s,speed_mps"
        for name, rows in zip((f"{kind}.csv", f"cut_{kind}.csv"), both, strict=True):
            text = [",".join(repr(float(value)) for value in row) for row in rows]
            (folder / name).write_text("\n".join([header, *text]) + "\n")
        given = ("--vehicle", CAR, "--state", "car.json", "--charge", 8, "--json", "f.json")
        ended = evpinn("forecast", f"{kind}.csv", f"cut_{kind}.csv", *given, cwd=folder)
        assert ended.returncode == 0, ended.stderr
        whole, cut = json.loads((folder / "f.json").read_text())
        for name in ("energy_j", "sigma_j", "duration_s", "distance_m", "uneven_j"):
            assert cut[name] == pytest.approx(whole[name], rel=1e-9)
        for name in ("charge_pct", "charge_sigma_pct", "empty_at_m"):
            same = (cut[name], whole[name])
            assert same == (None, None) or same[0] == pytest.approx(same[1], rel=1e-9, abs=1e-9)
        assert abs(cut["more_than_first_j"]) < 1e-3


def test_a_charge_that_no_plan_has_takes_no_column(evpinn, folder):
    for given, there in (((), False), (("--charge", 60), True)):
        ended = evpinn("forecast", "slow.csv", "fast.csv", "--vehicle", CAR, *given, cwd=folder)
        header = next(line for line in ended.stdout.splitlines() if "kWh/100 km" in line)
        assert ("charge after" in header) == there and "more than the first" in header
