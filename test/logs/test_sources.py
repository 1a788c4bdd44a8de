"""Every kind of recording gives the same readings."""

import gzip

import pytest

from evpinn_ros.bags.convert import write_readings
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.can.logs import write_log
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.sources import open_source
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("tesla_model_3_lr")


@pytest.fixture(scope="module")
def short_drive(vehicle):
    return simulate(DriveKind.URBAN, vehicle, 20.0, seed=3)


def test_can_log_gives_the_readings_of_the_simulated_bus(tmp_path, vehicle, short_drive):
    write_log(tmp_path / "drive.log", short_drive.frames)
    source = open_source(tmp_path / "drive.log", vehicle)
    assert [*map(repr, source.readings())] == [
        *map(repr, short_drive.readings)
    ]  # NaN is not equal
    assert source.problem is None


def test_a_can_log_that_later_contradicts_the_profile_ends_there(tmp_path, vehicle):
    """Two drives joined, the second of a car with the firmware of another year."""
    first = simulate(DriveKind.URBAN, vehicle, 30.0, seed=3)
    later = simulate(
        *(DriveKind.URBAN, vehicle, 30.0, 4),
        can_profile="tesla_model_3_2019",
        start_ns=first.frames[0].stamp_ns + 30 * 10**9,
    )
    write_log(tmp_path / "two.log", [*first.frames, *later.frames])
    source = open_source(tmp_path / "two.log", vehicle)
    readings = list(source.readings())
    end = readings[-1].stamp_ns - first.frames[0].stamp_ns
    assert 29 * 10**9 < end < 36 * 10**9
    assert "two.log: profile 'tesla_model_3' contradicts" in source.problem
    assert "'tesla_model_3_2019' fits better" in source.problem
    trusting = open_source(tmp_path / "two.log", vehicle, ReadOptions(trust_profile=True))
    again = [*map(repr, trusting.readings())]
    assert again[: len(readings)] == [*map(repr, readings)] and trusting.problem is None


def test_bag_gives_stamps_and_values(tmp_path, vehicle, short_drive):
    with BagWriter(tmp_path / "bag") as writer:
        write_readings(short_drive.readings, writer)
    found = list(open_source(tmp_path / "bag", vehicle).readings())
    assert [r.stamp_ns for r in found] == sorted(r.stamp_ns for r in short_drive.readings)


def test_csv_plain_and_compressed(tmp_path, vehicle):
    text = "t_s,speed_mps,power_w\n0.0,1.0,3500\n0.1,1.5,\n"
    (tmp_path / "drive.csv").write_text(text)
    with gzip.open(tmp_path / "drive.csv.gz", "wt") as file:
        file.write(text)
    plain = list(open_source(tmp_path / "drive.csv", vehicle).readings())
    packed = list(open_source(tmp_path / "drive.csv.gz", vehicle).readings())
    assert repr(plain) == repr(packed)  # what a table does not hold is NaN, which equals nothing
    assert len(plain) == 3  # the empty cell makes no message
    assert plain[1].power == pytest.approx(3500.0)
    assert plain[1].voltage == vehicle.nominal_voltage


def test_a_bag_is_read_without_what_reads_buses(loads_without):
    code = (
        "from pathlib import Path; from evpinn_ros.replays.car import CarReplay, ReplayOptions;"
        "source = CarReplay('generic', ReplayOptions()).open(Path('bags/urban'));"
        "next(source.readings())"
    )
    loads_without(code, "can", "cantools", "udsoncan", "torch")
