"""Every parser of what comes from outside, in one table.

A parser may raise `InputError` or count what it drops; anything else that it raises is a bug.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
import json
from pathlib import Path
from random import Random
import re
from tempfile import TemporaryDirectory
from typing import Any

import can.io.mf4
import numpy as np
from paho.mqtt.client import MQTTMessage

from evpinn_ros import topics
from evpinn_ros.bags.convert import BagReadings
from evpinn_ros.bags.metadata import METADATA
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.recover import recover
from evpinn_ros.bags.storage import Storage, change_storage
from evpinn_ros.bags.types import decode
from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.logs import LogFile
from evpinn_ros.can.profile import bundled_profiles, load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.energy.account import EnergyAccount
from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.meter import EnergyMeter
from evpinn_ros.core.energy.plan import Plan, plan_from_speed_profile
from evpinn_ros.core.energy.power_model import PowerModel, Weather
from evpinn_ros.core.energy.rknn import load_rknn
from evpinn_ros.core.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.core.estimation.state_file import read_state
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.extras.bridges.bridge import BridgeSettings, MqttBridge
from evpinn_ros.extras.bridges.broker import BrokerSettings, Connection
from evpinn_ros.extras.bridges.layouts import Layout, read_layout
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
    flipped,
    mutate_blf,
    mutate_database,
    mutate_json,
    mutate_mcap,
    mutate_mf4,
    mutate_packed,
    mutate_plan,
    mutate_table,
    mutate_text,
    mutate_yaml,
)

_PACKED_METADATA = """rosbag2_bagfile_information:
  compression_mode: FILE
  relative_file_paths: [drive.mcap.zstd]
"""


LARGEST = 1_000_000  # bytes of an input: parts repeated of parts repeated have no end


@dataclass(frozen=True, slots=True)
class Target:
    """One parser."""

    name: str  # of the target
    file_name: str  # under which it gets an input
    seeds: Callable[[], list[bytes]]  # makes sound inputs
    parse: Callable[[Path], object]  # reads the file; it may raise InputError and nothing else
    # makes what the parser needs in the folder of the file
    beside: Callable[[Path], object] = lambda folder: None
    # damages an input, and keeps its structure where it has one to keep
    mutate: Mutate = flipped

    def attack(self, folder: Path, seeds: list[bytes], chance: Random) -> None:
        """Parse an input that is damaged once to three times, in a folder made by `beside`.

        Raises:
            Exception: a bug was found.
        """
        data = chance.choice(seeds if chance.randrange(30) else [chance.randbytes(200), b"\n"])
        for _ in range(chance.randint(1, 3)):
            data = (flipped if not chance.randrange(4) else self.mutate)(data, chance)
            data = data[:LARGEST]
        path = folder / self.file_name
        path.write_bytes(data)
        try:
            self.parse(path)
        except InputError as error:
            assert str(error) and "\n" not in str(error), f"not one line: {error!r}"


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
        saved = sum(report.messages for report in recover(path, Path(folder, "saved")))
        try:
            with BagReader(Path(folder, "saved")) as reader:
                read = sum(1 for _ in reader.log_times())
        except InputError as error:
            raise AssertionError("what was recovered cannot be read") from error
    if read != saved:
        raise AssertionError(f"{saved} messages saved, {read} read")


def _stored_anew(storage: Storage, path: Path) -> None:
    """Check that a bag in the other storage holds what was said."""
    with TemporaryDirectory(dir=path.parent) as folder:
        written = change_storage(path, Path(folder, "new"), storage)
        with BagReader(Path(folder, "new")) as reader:
            read = sum(1 for _ in reader.log_times())
    if read != written:
        raise AssertionError(f"{written} messages written, {read} read")


def _mcap_beside(folder: Path) -> None:
    (folder / "drive.mcap").write_bytes(seeds.mcap_files()[0])


def _packed_beside(folder: Path) -> None:
    (folder / METADATA).write_text(_PACKED_METADATA)


def read_log(path: Path) -> tuple[list[CanFrame], LogFile | None]:
    """The frames of a log and its reader; what it promises holds whatever is in the file."""
    frames: list[CanFrame] = []
    try:
        log = open_can_log(path)
        log.seconds  # noqa: B018
        for frame in log.frames():
            frames.append(frame)
    except InputError as error:
        assert not frames, "a log that began well ends with its problem, not with an error"
        assert str(path) in str(error) and "\n" not in str(error)
        return [], None
    assert log.count == len(frames) > 0
    if log.problem is not None:
        assert log.problem.startswith(str(path)) and "\n" not in log.problem
        assert re.search(rf"\b{len(frames)} frames", log.problem)
    for frame in frames:
        assert type(frame) is CanFrame and type(frame.stamp_ns) is int
        assert 0 <= frame.can_id < 2 ** (29 if frame.extended else 11)
        assert type(frame.data) is bytes and len(frame.data) <= 64
    return frames, log


@cache
def _layout() -> Layout:
    return read_layout("ovms")


def _broker(path: Path) -> None:
    """Messages through the bridge; what it would publish is JSON, of topics that brokers take."""
    try:
        rows = json.loads(path.read_bytes().decode("utf-8", "replace"))
    except (ValueError, RecursionError):
        return
    now_ns = [seeds.START]
    given = BridgeSettings(_layout(), {}, _vehicle(), EstimatorSettings())
    broker = BrokerSettings("localhost")
    connection = Connection(broker, given.subscriptions, given.status_topic, lambda: now_ns[0])
    bridge = MqttBridge(given, connection)
    for row in rows if isinstance(rows, list) else ():
        parts = [*(row if isinstance(row, list) else [row]), "", "", 0, 1][:4]
        topic, payload = (str(part).encode("utf-8", "surrogatepass") for part in parts[:2])
        message = MQTTMessage(topic=topic)
        message.payload, message.retain = payload, bool(parts[2])
        connection._on_message(None, None, message)
        now_ns[0] += int(parts[3] == 1) * NANOSECONDS // 8
        bridge.step(0.0)
    bridge.close()
    for topic, (payload, _) in connection._outbox.items():
        assert not set(topic) & set("+#\0")
        if payload[:1] == "{":
            json.loads(payload, parse_constant=_not_json)


def _not_json(constant: str) -> None:
    raise AssertionError(constant)


def _csv_drive(path: Path) -> None:
    for reading in open_drive(path, 350.0).readings():
        float(reading.stamp_ns)


def _plan_file(path: Path) -> None:
    """A plan is finite and takes time, or is refused."""
    plan = read_plan(path)
    steps = np.diff(plan.time) if isinstance(plan, Plan) else plan.duration
    length = plan.distance if isinstance(plan, Plan) else plan.length
    assert np.isfinite(length).all() and (steps > 0.0).all()


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


def _can_log(suffix: str, mutate: Mutate) -> Target:
    name = f"drive{suffix}"
    return Target(name, name, partial(seeds.can_log, suffix), read_log, mutate=mutate)


TARGETS = (
    Target("mcap", "drive.mcap", seeds.mcap_files, _bag, mutate=mutate_mcap),
    Target("recover", "drive.mcap", seeds.mcap_files, _recovered, mutate=mutate_mcap),
    Target("sqlite3", "drive.db3", seeds.database, _bag, mutate=mutate_database),
    Target(
        *("to sqlite3", "drive.mcap", seeds.mcap_files, partial(_stored_anew, Storage.SQLITE3)),
        mutate=mutate_mcap,
    ),
    Target(
        *("to mcap", "drive.db3", seeds.database, partial(_stored_anew, Storage.MCAP)),
        mutate=mutate_database,
    ),
    Target("packed", "drive.mcap.zstd", seeds.packed_file, _bag_folder, _packed_beside),
    _settings("metadata", METADATA, seeds.metadata, _bag_folder, _mcap_beside),
    *(_can_log(suffix, mutate_text) for suffix in (".log", ".asc", ".trc", ".csv")),
    _can_log(".blf", mutate_blf),
    *([_can_log(".mf4", mutate_mf4)] if can.io.mf4.asammdf else []),
    Target("log.gz", "drive.log.gz", seeds.zipped_log, read_log, mutate=mutate_packed),
    Target("drive", "drive.csv", seeds.csv_drive, _csv_drive, mutate=mutate_table),
    Target("drive.gz", "drive.csv.gz", seeds.zipped_drive, _csv_drive, mutate=mutate_packed),
    Target("xlsx", "drive.xlsx", seeds.workbooks, _csv_drive, mutate=mutate_packed),
    Target("parquet", "drive.parquet", seeds.parquet_files, _csv_drive),
    Target("feather", "drive.feather", seeds.feather_files, _csv_drive),
    Target("jsonl", "drive.jsonl", seeds.json_lines, _csv_drive, mutate=mutate_text),
    Target("json", "drive.json", seeds.json_document, _csv_drive, mutate=mutate_json),
    Target("route", "plan", seeds.plan_files, _plan_file, mutate=mutate_plan),
    Target("legs", "plan.csv", seeds.plan_tables, _plan_file, mutate=mutate_table),
    Target(
        "dbc", "input.dbc", _bundled("can/tesla_model_3.dbc"), _dbc, _profile_beside, mutate_text
    ),
    _settings("profile", "p.yaml", _bundled("can/*.yaml"), load_profile, _dbc_beside),
    _settings("vehicle", "car.yaml", _bundled("vehicles/*.yaml"), load_vehicle),
    _settings("params", "p.yaml", _bundled("*.param.yaml"), check_parameter_file),
    _settings("mapping", "m.yaml", _bundled("mqtt/*.yaml"), lambda path: read_layout(str(path))),
    _settings("truth", TRUTH_FILE, seeds.truth, lambda path: read_truth(path.parent)),
    Target("state", "s.json", _estimator_seed, _estimator_state, mutate=mutate_json),
    Target("energy", "e.json", _account_seed, _energy_state, mutate=mutate_json),
    Target("broker", "b.json", seeds.broker_messages, _broker, mutate=mutate_json),
    Target("message", "m", seeds.messages, partial(_refused, _reading)),
    Target("model", "m", seeds.model, partial(_refused, _model)),
    Target("plan", "m", seeds.plans, partial(_refused, _plan)),
    Target("frames", "f", seeds.frames, _frames),
)
