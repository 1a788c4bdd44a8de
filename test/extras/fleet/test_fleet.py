"""`evpinn fleet` as a person meets it."""

from contextlib import suppress
import json
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from evpinn_ros.cli.main import app
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.common.writer import DRAFT
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.extras.fleet import fleet as fleet_command
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.output import write
from evpinn_ros.replays.simulation.simulate import simulate
from test.waiting import wait_until

parquet = pytest.importorskip("pyarrow.parquet", reason="the extra fleet is not installed")
COMMAND = [sys.executable, "-m", "evpinn_ros", "fleet"]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A folder of two Leafs, one with a bag that is none."""
    folder = tmp_path_factory.mktemp("data")
    for index, name in enumerate(("ann/monday", "ann/tuesday", "bob/monday")):
        write(simulate(DriveKind.URBAN, load_vehicle("nissan_leaf"), 20.0, index), folder / name)
    (folder / "bob" / "bad.mcap").write_bytes(b"no bag")
    return folder


def write_long_drive(path):
    """A day of driving, which takes long to learn; the cars before it, tenths of a second."""
    seconds = np.arange(0.0, 86_400.0, 0.5)
    speed = 15.0 + 10.0 * np.sin(seconds / 20.0)
    columns = seconds, speed, np.full_like(speed, 360.0), 20.0 + speed
    header = "t_s,speed_mps,voltage_v,current_a"
    np.savetxt(path, np.stack(columns, axis=1), "%.2f", ",", header=header, comments="")


def run(*arguments):
    return CliRunner().invoke(app, ["fleet", *map(str, arguments)])


def read(path):
    return parquet.read_table(path).to_pylist()


def learn(recorded, out, *more):
    return run(recorded, "--vehicle", "nissan_leaf", "--out", out, "--workers", 1, *more)


def test_a_fleet_becomes_tables_a_report_and_a_vehicle_file(recorded, tmp_path):
    out, file = tmp_path / "out", tmp_path / "leaf_fleet.yaml"
    ended = learn(recorded, out, "--write-vehicle", file, "--json", tmp_path / "found.json")
    assert ended.exit_code == 0, ended.output
    assert "2 cars, 3 of 4 drives learned, 1 problem." in ended.output
    assert "bad.mcap: not an MCAP file" in ended.output
    drives = {row["path"].split("/data0/")[-1]: row for row in read(out / "drives.parquet")}
    assert len(drives) == 4
    cars = read(out / "cars.parquet")
    assert [(row["car"], row["drives"], row["learned"]) for row in cars] == [
        ("ann", 2, 2),
        ("bob", 2, 1),
    ]
    assert all(row["in_population"] and row["mass"] > 1000 for row in cars)
    population = {row["name"]: row for row in read(out / "population.parquet")}
    assert len(population["mass"]["covariance"]) == 6
    assert population["mass_over_eta"]["cars"] > population["c_d"]["cars"]
    document = json.loads((tmp_path / "found.json").read_text())
    assert (document["stopped"], document["drives"], document["problems"]) == (False, 4, 1)
    assert document["failed"][0]["what"].endswith("bad.mcap")
    assert document["populations"]["nissan_leaf"]["mass"]["mean"] == population["mass"]["mean"]
    page = (out / "report.html").read_text()
    for text in ("ann", "nissan_leaf", "bad.mcap", "mass_over_eta", "evpinn fleet"):
        assert text in page
    assert "2 cars, 3 of 4 drives learned, 1 problem." in page
    assert page.count('<div class="forest">') == 5 and page.count(">bob<") == 6  # charts and table
    assert "http:" not in page and "https:" not in page
    learned = load_vehicle(file)
    assert learned.priors["eta"].std < load_vehicle("nissan_leaf").priors["eta"].std * 1.01
    state = json.loads((out / "cars" / "ann" / "state.json").read_text())
    assert state["vehicle"] == "nissan_leaf", "as evpinn replay --state takes it"


def processes_of(group):
    """Living processes of a group: a run and its workers (Linux)."""
    living = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, of = path.read_text().rpartition(")")[2].split()[:3]
            living += [path.parent.name] if int(of) == group and state != "Z" else []
    return living


@pytest.mark.parametrize(
    "end", [signal.SIGINT, pytest.param(signal.SIGKILL, marks=pytest.mark.nightly)]
)
def test_an_interrupted_run_leaves_results_and_goes_on(recorded, tmp_path, end):
    data, out = tmp_path / "data", tmp_path / "out"
    shutil.copytree(recorded, data)
    (data / "cy").mkdir()
    write_long_drive(data / "cy" / "long.csv")
    arguments = [data, "--vehicle", "nissan_leaf", "--out", out, "--workers", "1"]
    process = subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        cwd=share_directory(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    first = out / "cars" / "bob" / "result.json"
    wait_until(first.exists)
    if end == signal.SIGINT:
        os.killpg(process.pid, end)  # as a terminal does: to the workers too
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 1
        assert "the same command continues" in errors and "Traceback" not in errors
        assert [row["car"] for row in read(out / "cars.parquet")] == ["ann", "bob"]
    else:
        process.kill()
        process.communicate(timeout=60)
        wait_until(lambda: not processes_of(process.pid))
    shutil.rmtree(data / "cy")
    again = run(*arguments)
    assert again.exit_code == 0, again.output
    assert "2 cars, 3 of 4 drives learned" in again.output
    for car in ("ann", "bob"):
        assert not [path.name for path in (out / "cars" / car).glob(f"{DRAFT}*")]
    learn(data, tmp_path / "whole")
    states = [folder / "cars" / "ann" / "state.json" for folder in (out, tmp_path / "whole")]
    assert json.loads(states[0].read_text()) == json.loads(states[1].read_text())


def test_two_runs_do_not_write_to_one_folder(recorded, tmp_path):
    with fleet_command.claimed(tmp_path):
        ended = learn(recorded, tmp_path)
    assert "another evpinn fleet" in str(ended.exception)


def test_what_links_lead_to_is_not_written(recorded, tmp_path):
    """A state of 312 kB was empty afterwards."""
    out, victim = tmp_path / "out", tmp_path / "car.json"
    victim.write_text("precious")
    out.mkdir()
    (out / ".lock").symlink_to(victim)
    ended = learn(recorded, out)
    assert ".lock: Too many levels of symbolic links" in str(ended.exception)
    (out / ".lock").unlink()
    (out / ".lock").hardlink_to(victim)
    (out / ".stop").symlink_to(tmp_path / "elsewhere")
    assert learn(recorded, out).exit_code == 0
    assert victim.read_text() == "precious" and not (tmp_path / "elsewhere").exists()


@pytest.mark.nightly
def test_the_same_on_a_cluster(recorded, tmp_path):
    distributed = pytest.importorskip("distributed", reason="the extra fleet is not installed")
    here, there = tmp_path / "here", tmp_path / "there"
    learn(recorded, here)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0"
    ) as cluster:
        ended = learn(recorded, there, "--scheduler", cluster.scheduler_address)
    assert ended.exit_code == 0, ended.output
    for name in ("drives", "cars", "population"):
        assert read(here / f"{name}.parquet") == read(there / f"{name}.parquet")
