"""Every kind of recording gives the same readings."""

from evpinn_ros.can.logs import write_log
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.sources import open_source
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate


def test_a_can_log_that_later_contradicts_the_profile_ends_there(tmp_path):
    """Two drives joined, the second of a car with the firmware of another year."""
    vehicle = load_vehicle("tesla_model_3_lr")
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


def test_a_bag_is_read_without_what_reads_buses(loads_without):
    code = (
        "from pathlib import Path; from evpinn_ros.replays.car import CarReplay, ReplayOptions;"
        "source = CarReplay('generic', ReplayOptions()).open(Path('bags/urban'));"
        "next(source.readings())"
    )
    loads_without(code, "can", "cantools", "udsoncan", "torch")
