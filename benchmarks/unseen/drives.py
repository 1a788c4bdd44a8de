"""The cars of the given data folder, each with its drives in order of time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
import math
from pathlib import Path

import numpy as np

from benchmarks.unseen.fastsim_cars import (
    FASTSIM_CARS,
    fastsim_is_there,
    fastsim_readings,
    fastsim_truth,
    simulate_fastsim,
)
from benchmarks.unseen.lines import DrivePart, Line, battery_power, common, speed_line
from benchmarks.unseen.splitting import split
from benchmarks.unseen.sumo_cars import SUMO_CARS, simulate_sumo, sumo_is_there, sumo_truth
from benchmarks.unseen.truth import CARRIED_VEHICLE, CHANGCHUN, carried_drives
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    MotorReading,
    Reading,
    TemperatureReading,
)
from evpinn_ros.core.signals.reorder import in_order
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.logs.formats import recordings
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.sources import open_source


@dataclass(frozen=True)
class UnseenDrive:
    """One drive: its readings in recorded order."""

    name: str
    readings: tuple[Reading, ...]

    @property
    def start_ns(self) -> int:
        """Stamp that times of this drive count from."""
        return self.readings[0].stamp_ns

    def intervals(self, vehicle: Vehicle) -> Iterator[Interval]:
        """All intervals of the drive, also those that are too poor to learn from."""
        stream = SampleStream(StreamSettings(), vehicle.air_density, vehicle.motor_ratio)
        events = stream.add(in_order(Block.of(self.readings)))
        return (interval for _, interval in events.intervals)

    def seconds(self, stamp_ns: int) -> float:
        """Time since the start, s."""
        return (stamp_ns - self.start_ns) / NANOSECONDS

    @cached_property
    def power(self) -> Line:
        """Measured battery power, W."""
        return battery_power(self.readings, self.start_ns)

    @cached_property
    def paired(self) -> tuple[Reading, ...]:
        """The readings; a voltage or current that lacks the other gets it by interpolation."""
        rows = [reading for reading in self.readings if isinstance(reading, BatteryReading)]
        time = np.array([self.seconds(reading.stamp_ns) for reading in rows])
        volts, amperes = (
            Line(time, np.array([getattr(reading, name) for reading in rows], float)).at(time)
            for name in ("voltage", "current")
        )
        pairs = iter(zip(volts.tolist(), amperes.tolist(), strict=True))
        return tuple(
            _completed(reading, *next(pairs)) if isinstance(reading, BatteryReading) else reading
            for reading in self.readings
        )

    @cached_property
    def speed(self) -> Line:
        """Measured speed, m/s."""
        return speed_line(self.readings, self.start_ns)

    @cached_property
    def spans(self) -> list[DrivePart]:
        """Spans in which speed and battery are both known; these are scored."""
        return common(self.power.spans(), self.speed.spans())

    @property
    def duration(self) -> float:
        """From the start to the last speed, s."""
        return float(self.speed.time[-1]) if self.speed.time.size else 0.0

    @property
    def distance(self) -> float:
        """Driven, m."""
        return self.speed.over(DrivePart(0.0, self.duration)) if self.speed.time.size > 1 else 0.0


def _completed(reading: BatteryReading, volts: float, amperes: float) -> BatteryReading:
    """The reading with the voltage or current that it lacks."""
    if math.isnan(reading.voltage):
        return replace(reading, voltage=volts)
    return replace(reading, current=amperes) if math.isnan(reading.current) else reading


@dataclass(frozen=True)
class UnseenCar:
    """A car and its drives, in order."""

    key: str  # its name in `--cars`
    vehicle: Vehicle  # all that a method knows of it
    drives: tuple[UnseenDrive, ...]  # in order of time
    # true combinations by `method.NAMES`, empty where they are unknown
    truth: dict[str, float] = field(default_factory=dict)

    @property
    def hours(self) -> float:
        """Driving time, h."""
        return sum(drive.duration for drive in self.drives) / 3600.0


@dataclass(frozen=True)
class Folder:
    """Folder of a car's drives, with the vehicle file and what of them is hidden or known."""

    pattern: str  # of files in the folder of data
    vehicle: str
    hidden: tuple[type, ...] = (MotorReading,)
    truth: Mapping[str, float] = field(default_factory=dict)
    can_profile: str | None = None  # where it is not the vehicle's own


ALL_BUT_SPEED = (AltitudeReading, AuxiliaryReading, MotorReading, TemperatureReading)

# The folders of `../shared/data`; a file name sorts by its date.
FOLDERS = {
    "model3": Folder("tesla_model3/*.csv", "tesla_model_3_lr"),
    "i3": Folder("bmw_i3/*.csv.gz", "bmw_i3"),
    "i3_speed": Folder("bmw_i3/*.csv.gz", "bmw_i3", hidden=ALL_BUT_SPEED),
    "i3_torque": Folder("bmw_i3/*.csv.gz", "bmw_i3", hidden=()),
    "e208": Folder("peugeot_e208_car_scanner/*.csv.gz", "peugeot_e_208_50_kwh_2020"),
    "changchun": Folder("changchun_sedan/trip_*.csv.gz", "generic", truth=CHANGCHUN),
    # The same car on rollers: its road load is known there, and there is neither wind nor slope.
    "changchun_rollers": Folder("changchun_sedan/dyno_*.csv.gz", "generic", truth=CHANGCHUN),
    "leaf2013": Folder("nissan_leaf_2013_leafspy/*.csv.gz", "nissan_leaf_24_kwh"),
    "three_wheeler": Folder("cargo_three_wheeler/*.csv.gz", "generic"),
    "can_model3": Folder("can/tesla_model3_2019/decoded*.csv", "tesla_model_3_lr"),
    "can_model_s": Folder("can/tesla_model_s_2017/decoded*.csv", "tesla_model_s"),
    "can_leaf": Folder("can/nissan_leaf_62kwh/decoded*.csv", "nissan_leaf"),
}


LOG_PART = ":"  # between the name of a log and the number of its drive
SIMULATED = "simulated"


def inputs_of(names: Iterable[str]) -> Iterator[Path]:
    """Every file from which data or cars with these names may be read."""
    for name in names:
        path, _, vehicle = name.rpartition("=")
        for root in map(Path, (path, *vehicle.split(",")) if path else (name,)):
            yield root
            yield from root.rglob("*")


def cars_in(data: str, *, recorded: bool = False) -> list[str]:
    """Names of the cars whose drives are in a folder, and of simulated cars.

    PATH=VEHICLE is a car itself. Cars by SUMO and FASTSim are included if these are installed.

    Raises:
        InputError: there is no such folder, or `recorded` and no recorded car in it.
    """
    root = Path(data)
    if not root.exists() and "=" in data:
        return [data]
    if not root.is_dir():
        raise InputError(f"{data}: no such folder")
    keys = [key for key, folder in FOLDERS.items() if any(root.glob(folder.pattern))]
    if recorded and not keys:
        raise InputError(
            f"{data}: has none of {', '.join(folder.pattern for folder in FOLDERS.values())}; "
            "recordings of your own are PATH=VEHICLE"
        )
    by_sumo = SUMO_CARS if sumo_is_there() else ()
    return [*keys, SIMULATED, *by_sumo, *(FASTSIM_CARS if fastsim_is_there(root) else ())]


def load_car(data: str, key: str) -> UnseenCar:
    """Read or simulate the drives of a car.

    Raises:
        InputError: no drive can be read.
    """
    if key == SIMULATED:
        drives = tuple(
            UnseenDrive(f"{i}", readings) for i, readings in enumerate(carried_drives())
        )
        return UnseenCar(key, load_vehicle(CARRIED_VEHICLE), drives)
    if key in SUMO_CARS:
        readings, trace = simulate_sumo(key)
        generic = load_vehicle("generic")
        return UnseenCar(
            key, generic, (UnseenDrive(key, readings),), sumo_truth(key, trace, generic)
        )
    if key in FASTSIM_CARS:
        traces, generic = simulate_fastsim(key, Path(data)), load_vehicle("generic")
        cycles = enumerate(fastsim_readings(traces))
        drives = tuple(UnseenDrive(f"{key} {i}", readings) for i, readings in cycles)
        return UnseenCar(key, generic, drives, fastsim_truth(traces, generic))
    known = FOLDERS.get(key)
    folder = known or _own_folder(key)
    car = load_vehicle(folder.vehicle)
    logs = Path(data).glob(known.pattern) if known else recordings(Path(folder.pattern))
    drives = tuple(_drives(sorted(logs), car, folder))
    if not drives:
        raise InputError(f"{data}: no drive of {key} can be read")
    return UnseenCar(key, car, drives, dict(folder.truth))


def _own_folder(key: str) -> Folder:
    """The folder in `PATH=VEHICLE` or `PATH=VEHICLE,PROFILE`."""
    path, _, vehicle = key.rpartition("=")
    if not Path(path).exists():
        raise InputError(f"{path}: no such file or folder")
    vehicle, _, profile = vehicle.partition(",")
    return Folder(path, vehicle, hidden=(), can_profile=profile or None)


def _drives(paths: Sequence[Path], car: Vehicle, folder: Folder) -> Iterator[UnseenDrive]:
    for path in paths:
        source = open_source(path, car, ReadOptions(folder.can_profile))
        readings = tuple(
            reading for reading in source.readings() if not isinstance(reading, folder.hidden)
        )
        for number, part in enumerate(split(readings), start=1):
            drive = UnseenDrive(f"{path.name.split('.')[0]}{LOG_PART}{number}", part)
            if drive.spans:
                yield drive
