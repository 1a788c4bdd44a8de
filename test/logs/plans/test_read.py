"""One function for every file: told by what is in it, and recorded drives as plans."""

import gzip
from itertools import islice
import json
import os

import numpy as np
import polars as pl
import pytest

from evpinn_ros.bags.convert import BagReadings
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import new_message
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.plan import Legs, Plan, PlanError
from evpinn_ros.core.signals.readings import AltitudeReading, GradeReading, SpeedReading
from evpinn_ros.logs.plans import read as reader
from evpinn_ros.logs.plans import read_plan
from evpinn_ros.logs.plans.read import plan_of_readings
from evpinn_ros.topics import PATH_TYPE
from evpinn_ros.topics.messages import header
from test.conftest import ROOT
from test.logs.plans import samples
from test.logs.plans.test_table import LEGS, SPEEDS
from test.logs.plans.test_track import gpx

DRIVE = "t_s,speed_mps,voltage_v,current_a,elevation_m\n" + "".join(
    f"{t / 2},{min(t, 40) / 2},{350 - t},{t},{500 + t / 10}\n" for t in range(200)
)
URBAN = ROOT / "bags" / "urban"


@pytest.mark.parametrize("name", ["plan", "plan.txt", "plan.json", "plan.gpx", "plan.csv"])
@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (SPEEDS, Plan),
        (LEGS, Legs),
        (gpx(), Legs),
        ("\ufeff\n" + json.dumps(samples.osrm()), Legs),
        (json.dumps(samples.osrm()).encode("utf-16"), Legs),
    ],
    ids=["speeds", "legs", "gpx", "route", "route in utf-16"],
)
def test_a_file_is_told_by_its_content_not_by_its_name(read, name, content, kind):
    assert isinstance(read(content, name), kind)


@pytest.mark.parametrize("content", [SPEEDS, gpx(), json.dumps(samples.osrm())])
def test_a_gzipped_file_is_what_is_in_it(tmp_path, read, content):
    (tmp_path / "plan.csv.gz").write_bytes(gzip.compress(content.encode()))
    packed, plain = read_plan(tmp_path / "plan.csv.gz"), read(content)
    name = "time" if isinstance(plain, Plan) else "duration"
    assert (getattr(packed, name) == getattr(plain, name)).all()


def test_a_recorded_drive_is_its_speed_and_height_without_its_battery(read):
    plan = read(DRIVE, "drive.csv")
    assert isinstance(plan, Plan)
    assert plan.time.tolist() == [*range(99), 99.5]
    assert plan.speed == pytest.approx(np.minimum(plan.time, 20.0))
    assert plan.elevation[80] - plan.elevation[20] == pytest.approx(12.0, abs=0.2)
    rows = json.loads(pl.read_csv(DRIVE.encode()).write_json())
    for document in (rows, {"trip": {"samples": rows}}):
        assert (read(document, "drive.json").distance == plan.distance).all()
    other = DRIVE.replace(",0,", ",-99,").replace("350", "400")
    assert (read(other, "other.csv").distance == plan.distance).all()


def test_a_bag_is_a_plan_whose_height_is_that_of_its_slopes():
    """As of the bundled drive, whose IMU gives grades and nobody an altitude."""
    plan = read_plan(URBAN)
    with BagReader(URBAN) as bag:
        readings = [*BagReadings(bag)]
    speeds = [r for r in readings if isinstance(r, SpeedReading)]
    time = np.array([r.stamp_ns for r in speeds]) / 1e9
    driven = np.trapezoid([r.speed for r in speeds], time)
    assert plan.distance[-1] == pytest.approx(driven, rel=0.005)
    assert plan.time[-1] == pytest.approx(time[-1] - time[0], abs=1.1)
    grades = {round(r.stamp_ns / 1e8): r.grade for r in readings if isinstance(r, GradeReading)}
    climb = sum(
        np.sin(grades.get(round(r.stamp_ns / 1e8), 0.0)) * r.speed * step
        for r, step in zip(speeds, np.diff(time, append=time[-1]), strict=True)
    )
    assert plan.elevation[-1] - plan.elevation[0] == pytest.approx(climb, abs=3.0)


def path_message(*points):
    return new_message(
        PATH_TYPE,
        header=header(new_message, 10**18, "map"),
        poses=[
            new_message(
                "geometry_msgs/msg/PoseStamped",
                header=header(new_message, 10**18 + stamp, "map"),
                pose=new_message(
                    "geometry_msgs/msg/Pose",
                    position=new_message("geometry_msgs/msg/Point", x=x, y=0.0, z=0.0),
                ),
            )
            for x, stamp in points
        ],
    )


def test_a_planner_s_bag_is_its_newest_plan_and_a_drive_s_is_the_drive(tmp_path):
    """A later plan that cannot be driven is passed over; of one alone it is said why."""
    old, new = path_message((0.0, 0), (500.0, 10**11)), path_message((0.0, 0), (900.0, 10**11))
    back = path_message((0.0, 10**11), (500.0, 0))
    with BagWriter(tmp_path / "plans") as bag:
        for second, message in enumerate((old, new, back)):
            bag.write("/plan", message, 10**18 + second * 10**9)
    plan = read_plan(tmp_path / "plans")
    assert plan.distance[-1] == 900.0 and plan.time[-1] == 100.0
    with BagWriter(tmp_path / "back") as bag:
        bag.write("/plan", back, 10**18)
    with pytest.raises(PlanError, match="back: /plan: time goes back"):
        read_plan(tmp_path / "back")
    with BagReader(URBAN) as drive, BagWriter(tmp_path / "both") as bag:
        for record in islice(drive.records(), 4000):
            bag.write(record.topic, record.message, record.log_time_ns)
        bag.write("/plan", new, record.log_time_ns)
    begin = read_plan(tmp_path / "both").speed[:-2]
    assert len(begin) > 20 and (begin == read_plan(URBAN).speed[: len(begin)]).all()


def readings_of(rows):
    return [SpeedReading(int(t * 1e9), v) for t, v in rows]


def test_a_gap_while_the_car_moved_is_left_out_and_one_while_it_stood_is_a_stop():
    moving = [(t, 15.0) for t in range(100)] + [(t, 15.0) for t in range(400, 500)]
    plan = plan_of_readings(readings_of(moving))
    assert plan.time[-1] == pytest.approx(199, abs=1.1)
    assert plan.distance[-1] == pytest.approx(15.0 * 199, rel=0.01)
    parked = [(t, min(t, 99 - t, 15.0)) for t in range(100)]
    plan = plan_of_readings(readings_of([*parked, *((t + 400, v) for t, v in parked)]))
    assert plan.time[-1] == pytest.approx(499, abs=1.1)
    assert plan.distance[350] == plan.distance[120]


def test_the_drives_of_a_day_follow_each_other_without_the_hours_between():
    day = [(t, 15.0) for t in range(100)] + [(t + 30_000, 10.0) for t in range(100)]
    heights = [AltitudeReading(int(t * 1e9), 500 + t % 30_000 / 10) for t, _ in day]
    plan = plan_of_readings([*readings_of(day), *heights])
    assert plan.time[-1] == pytest.approx(199, abs=1.1)
    assert plan.distance[-1] == pytest.approx(15.0 * 99 + 10.0 * 99, rel=0.02)
    assert plan.elevation[90] == pytest.approx(509.0, abs=1.0)
    assert plan.elevation[190] == pytest.approx(509.0, abs=1.0)


@pytest.mark.parametrize("time", ["time_s", "t_s", "Time [s]"])
def test_few_rows_of_a_plan_are_no_gaps(read, time):
    """Its points stay as they are, so that its speed is uneven between them, as in m/s."""
    plan = read(f"{time},Speed (km/h)\n0,0\n15,72\n400,72\n420,0\n", "plan.csv")
    same = read("t_s,speed_mps\n0,0\n15,20\n400,20\n420,0\n", "plan.csv")
    assert plan.time == pytest.approx(same.time) and plan.speed == pytest.approx(same.speed)
    assert plan.time[-1] == pytest.approx(420, abs=1.1)
    assert plan.distance[-1] == pytest.approx(8050.0, rel=0.001)


@pytest.mark.parametrize(
    ("content", "name", "reason"),
    [
        ("", "plan.csv", "the file is empty"),
        ("hello\n", "plan.csv", "neither a plan, with the columns t_s and speed_mps"),
        (
            "time,kmh\n0,0\n20,36\n400,72\n",
            "drive.csv",
            "no plan; name the column of times with its unit",
        ),
        (b"\x89MCAP0\r\n", "drive.mcap", "drive.mcap"),
        ("(0.0) can0 257#00\n", "drive.log", "names no CAN profile"),
    ],
)
def test_what_is_no_plan_is_refused_by_name_and_in_one_line(read, content, name, reason):
    with pytest.raises(InputError, match=reason) as error:
        read(content, name)
    assert name in str(error.value) and "\n" not in str(error.value)


def test_a_pipe_is_refused_and_a_file_that_is_too_large(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="a pipe or a device"):
        read_plan(tmp_path / "pipe")
    with pytest.raises(InputError, match="No such file"):
        read_plan(tmp_path / "none.gpx")
    with pytest.raises(InputError, match="null"):
        read_plan("a\0b")
    for name, content in (("MOST_XML", gpx()), ("MOST_JSON", json.dumps(samples.osrm()))):
        monkeypatch.setattr(reader, name, 300)
        (tmp_path / "long").write_text(content)
        with pytest.raises(PlanError, match="more than 300 bytes"):
            read_plan(tmp_path / "long")
