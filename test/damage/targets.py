"""Every parser of what comes from outside, in one table.

A parser may raise `InputError` or count what it drops; anything else that it raises is a bug.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from evpinn_ros import topics
from evpinn_ros.bags.convert import BagReadings
from evpinn_ros.bags.metadata import METADATA
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.recover import recover
from evpinn_ros.bags.types import decode
from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.profile import bundled_profiles, load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.energy.account import EnergyAccount
from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.meter import EnergyMeter
from evpinn_ros.core.energy.plan import plan_from_speed_profile
from evpinn_ros.core.energy.power_model import PowerModel, Weather
from evpinn_ros.core.energy.rknn import load_rknn
from evpinn_ros.core.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.core.estimation.state_file import read_state
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.logs.bus_sources import open_can_log
from evpinn_ros.logs.plans import read_plan
from evpinn_ros.logs.sources import open_drive
from evpinn_ros.replays.simulation.truth_file import TRUTH_FILE, read_truth
from evpinn_ros.topics.model import read_model
from evpinn_ros.topics.parameter_file import check_parameter_file
from evpinn_ros.topics.plans import plan_of_message
from evpinn_ros.topics.readings import READING_TOPICS, to_reading
from test.damage import seeds
from test.damage.seeds import READINGS, VEHICLE
from test.damage.structures import (
    Mutate,
    mutate_json,
    mutate_packed,
    mutate_table,
    mutate_yaml,
)

_PACKED_METADATA = """rosbag2_bagfile_information:
  compression_mode: FILE
  relative_file_paths: [drive.mcap.zstd]
"""


@dataclass(frozen=True, slots=True)
class Target:
    """One parser."""

    name: str  # of the target
    file_name: str  # under which it gets an input
    seeds: Callable[[], list[bytes]]  # makes sound inputs
    parse: Callable[[Path], object]  # reads the file; it may raise InputError and nothing else
    # makes what the parser needs in the folder of the file
    beside: Callable[[Path], object] = lambda folder: None
    # damages an input and keeps its structure, where it has one to keep
    mutate: Mutate | None = None

    def run(self, folder: Path, data: bytes) -> None:
        """Parse one input in a folder that was made ready by `beside`.

        Raises:
            Exception: a bug was found.
        """
        path = folder / self.file_name
        path.write_bytes(data)
        try:
            self.parse(path)
        except InputError as error:
            if "\n" in str(error) or not str(error):
                raise AssertionError(f"not one line: {error!r}") from error


def _bag(path: Path) -> None:
    with BagReader(path) as reader:
        for _ in reader.records():
            pass
        for _ in BagReadings(reader):
            pass


def _bag_folder(path: Path) -> None:
    _bag(path.parent)


def _recovered(path: Path) -> None:
    """Check that a recovered bag holds what the recovery reported."""
    with TemporaryDirectory(dir=path.parent) as folder:
        saved = sum(one.messages for one in recover(path, Path(folder, "saved")))
        try:
            with BagReader(Path(folder, "saved")) as reader:
                read = sum(1 for _ in reader.log_times())
        except InputError as error:
            raise AssertionError("what was recovered cannot be read") from error
    if read != saved:
        raise AssertionError(f"{saved} messages saved, {read} read")


def _mcap_beside(folder: Path) -> None:
    (folder / "drive.mcap").write_bytes(seeds.mcap_files()[0])


def _packed_beside(folder: Path) -> None:
    (folder / METADATA).write_text(_PACKED_METADATA)


def _log(path: Path) -> None:
    for _ in open_can_log(path).frames():
        pass


def _csv_drive(path: Path) -> None:
    for reading in open_drive(path, 350.0).readings():
        float(reading.stamp_ns)


def _dbc(path: Path) -> None:
    load_profile(path.with_name("profile.yaml"))


def _profile_beside(folder: Path) -> None:
    (profile,) = seeds.bundled("can/tesla_model_3.yaml")
    dbc = profile.replace(b"dbc: tesla_model_3.dbc", b"dbc: input.dbc")
    (folder / "profile.yaml").write_bytes(dbc)


def _dbc_beside(folder: Path) -> None:
    for path in (share_directory() / "config" / "can").glob("*.dbc"):
        (folder / path.name).write_bytes(path.read_bytes())


@cache
def _vehicle() -> Vehicle:
    return load_vehicle(VEHICLE)


@cache
def _estimator() -> OnlineEstimator:
    return OnlineEstimator(_vehicle(), EstimatorSettings(), InlineWorker(lambda: 0.0))


@cache
def _account() -> EnergyAccount:
    vehicle = _vehicle()
    return EnergyAccount(EnergyMeter(load_rknn()), vehicle.key, vehicle.battery_capacity)


def _estimator_state(path: Path) -> None:
    _estimator().restore(read_state(path) or {})


def _energy_state(path: Path) -> None:
    _account().restore(read_state(path) or {})
    _account().state, _account().summary()


def _refused(read: Callable[[bytes], object], path: Path) -> None:
    """Read a message; ValueError is what bags and nodes count (also BadMessage, a ValueError)."""
    try:
        read(path.read_bytes())
    except ValueError as error:
        raise InputError(str(error)) from error


def _reading(data: bytes) -> None:
    kind = type(READINGS[(data[0] if data else 0) % len(READINGS)])
    type_name = READING_TOPICS[kind].type_name
    reading = to_reading(type_name, decode(type_name, data[1:]))
    if not 0 < reading.stamp_ns < 1 << 63:
        raise AssertionError(reading)


def _model(data: bytes) -> None:
    model = read_model(decode(topics.ARRAY_TYPE, data), _vehicle())
    time_s = np.arange(6.0)
    plan = plan_from_speed_profile(time_s, 10 * time_s, np.full(6, 10.0))
    with np.errstate(all="ignore"):  # its numbers may be huge; what is not finite is not sent
        forecast_plan(plan, PowerModel(model), Weather(1.2))


def _plan(data: bytes) -> None:
    kind = topics.PATH_TYPE if data[:1] == b"\0" else topics.TRAJECTORY_TYPE
    plan_of_message(kind, data[1:], decode)


@cache
def _profiles() -> list[Any]:
    return bundled_profiles()


def _frames(path: Path) -> None:
    """Through the bridge of one car, chosen by the first byte; it never raises."""
    data = path.read_bytes()
    profile = _profiles()[data[0] % len(_profiles())] if data else _profiles()[0]
    bridge = CanBridge(profile, guard=FitGuard(profile, _profiles()))
    for frame in _cut(data):
        bridge.decode(frame)
    bridge.finish()
    bridge.status(seeds.START)


def _cut(data: bytes) -> Iterator[CanFrame]:
    position, stamp = 0, seeds.START
    while position + 5 <= len(data):
        can_id = int.from_bytes(data[position : position + 4], "big") & 0x1FFFFFFF
        end = position + 5 + min(data[position + 4], 64)
        stamp += seeds.STEP
        yield CanFrame(stamp, can_id, data[position + 5 : end], can_id > 0x7FF)
        position = end


def _bundled(pattern: str) -> Callable[[], list[bytes]]:
    return partial(seeds.bundled, pattern)


def _estimator_seed() -> list[bytes]:
    return seeds.as_json(_estimator().export())


def _account_seed() -> list[bytes]:
    return seeds.as_json(_account().export())


_settings = partial(Target, mutate=mutate_yaml)

TARGETS = (
    Target("mcap", "drive.mcap", seeds.mcap_files, _bag),
    Target("recover", "drive.mcap", seeds.mcap_files, _recovered),
    Target("sqlite3", "drive.db3", seeds.database, _bag),
    Target("packed", "drive.mcap.zstd", seeds.packed_file, _bag_folder, _packed_beside),
    _settings("metadata", METADATA, seeds.metadata, _bag_folder, _mcap_beside),
    *(
        Target(suffix.strip("."), f"drive{suffix}", partial(seeds.can_log, suffix), _log)
        for suffix in (".log", ".asc", ".trc", ".csv", ".blf")
    ),
    Target("log.gz", "drive.log.gz", seeds.zipped_log, _log, mutate=mutate_packed),
    Target("drive", "drive.csv", seeds.csv_drive, _csv_drive, mutate=mutate_table),
    Target("drive.gz", "drive.csv.gz", seeds.zipped_drive, _csv_drive, mutate=mutate_packed),
    Target("xlsx", "drive.xlsx", seeds.workbooks, _csv_drive, mutate=mutate_packed),
    Target("parquet", "drive.parquet", seeds.parquet_files, _csv_drive),
    Target("route", "plan", seeds.plan_files, read_plan, mutate=mutate_json),
    Target("legs", "plan.csv", seeds.plan_tables, read_plan, mutate=mutate_table),
    Target("dbc", "input.dbc", _bundled("can/tesla_model_3.dbc"), _dbc, _profile_beside),
    _settings("profile", "p.yaml", _bundled("can/*.yaml"), load_profile, _dbc_beside),
    _settings("vehicle", "car.yaml", _bundled("vehicles/*.yaml"), load_vehicle),
    _settings("params", "p.yaml", _bundled("*.param.yaml"), check_parameter_file),
    Target(
        "truth", TRUTH_FILE, seeds.truth, lambda path: read_truth(path.parent), mutate=mutate_yaml
    ),
    Target("state", "s.json", _estimator_seed, _estimator_state, mutate=mutate_json),
    Target("energy", "e.json", _account_seed, _energy_state, mutate=mutate_json),
    Target("message", "m", seeds.messages, partial(_refused, _reading)),
    Target("model", "m", seeds.model, partial(_refused, _model)),
    Target("plan", "m", seeds.plans, partial(_refused, _plan)),
    Target("frames", "f", seeds.frames, _frames),
)
