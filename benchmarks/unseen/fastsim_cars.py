"""Four electric cars of another simulator, FASTSim 3 (`fastsim` on PyPI), on standard cycles.

Mass, tyres, drag and the losses of motor, gearbox and battery by load come with FASTSim; no
constant of the core was chosen on these cars. Each drives three cycles on a flat road, and again
over hills of known height, with one speed a second and without noise; power is the mean of each
second. `benchmarks.fastsim_peer` says how to install FASTSim.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.fastsim_peer import fastsim_cycle, fastsim_version, read_cycle
from benchmarks.unseen.noise_free import Moved, noise_free_truth
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    Reading,
    SpeedReading,
)
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.replays.simulation.drive import hilly_road
from evpinn_ros.replays.simulation.simulate import EPOCH_NS, RMS_GRADE

FASTSIM_CARS = {
    "fastsim_leaf": "2016 Nissan Leaf 30 kWh thrml.yaml",
    "fastsim_bolt": "2020 Chevrolet Bolt EV thrml.yaml",
    "fastsim_model3": "2022 Tesla Model 3 RWD thrml.yaml",
    "fastsim_zoe": "2022_Renault_Zoe_ZE50_R135.yaml",
}
# Not US06, of which these cars miss a launch.
CYCLES = ("udds", "hwfet", "wltc_3b")
SEED, DAY_S, VOLTAGE = 30, 86_400, 360.0


class FastsimDrive(NamedTuple):
    """A drive of FASTSim by second, shape (n,) each; powers are those of the second before."""

    seconds: np.ndarray
    speed: np.ndarray  # m/s
    height: np.ndarray  # m
    power: np.ndarray  # of the battery, W
    p_aux: float  # W
    air_density: float  # kg/m^3


def fastsim_is_there(data: Path) -> bool:
    """Whether FASTSim is installed and the folder has its cycles."""
    return fastsim_version() is not None and (data / "drive_cycles").is_dir()


def simulate_fastsim(key: str, data: Path) -> list[FastsimDrive]:
    """Drive a car over every cycle, flat and then with hills."""
    rng = np.random.default_rng(SEED)
    traces = []
    for grade in (0.0, RMS_GRADE):
        for cycle in CYCLES:
            seconds, speed = read_cycle(data / "drive_cycles" / f"{cycle}.csv")
            steps = np.diff(seconds) * (speed[1:] + speed[:-1]) / 2
            way = np.concatenate(([0.0], np.cumsum(steps)))
            road = hilly_road(grade, rng)
            slope = np.concatenate(([0.0], road.mean_slope(way[:-1], way[1:])))
            traces.append(_drive(FASTSIM_CARS[key], seconds, speed, slope, road.elevation(way)))
    return traces


def fastsim_readings(traces: list[FastsimDrive]) -> Iterator[tuple[Reading, ...]]:
    """Readings of each drive, a day after the one before."""
    for day, trace in enumerate(traces):
        start_ns = EPOCH_NS + day * DAY_S * NANOSECONDS
        yield tuple(_readings(trace, start_ns))


def fastsim_truth(traces: list[FastsimDrive], vehicle: Vehicle) -> dict[str, float]:
    """The combinations that these drives determine, of an unlimited sensor (`noise_free`)."""
    parts = []
    for trace in traces:
        seconds, climb = np.diff(trace.seconds), np.diff(trace.height)
        moved = Moved.between(trace.speed[:-1], trace.speed[1:], seconds, climb)
        parts.append((*moved, trace.power[1:] * seconds))
    *columns, energy = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    first = traces[0]
    return noise_free_truth(Moved(*columns), energy, first.p_aux, vehicle, first.air_density)


def _drive(
    car: str, seconds: np.ndarray, speed: np.ndarray, slope: np.ndarray, height: np.ndarray
) -> FastsimDrive:
    fastsim = import_module("fastsim")
    drive = fastsim.SimDrive(
        fastsim.Vehicle.from_resource(car), fastsim_cycle(seconds, speed, slope)
    )
    drive.run()
    vehicle = drive.to_dict()["veh"]
    course, battery = vehicle["history"], vehicle["pt_type"]["BEV"]["res"]["history"]
    return FastsimDrive(
        seconds,
        np.array(course["speed_ach_meters_per_second"]),
        height,
        np.array(battery["pwr_out_electrical_watts"]),
        float(np.mean(course["pwr_aux_watts"][1:])),
        float(course["air_density_kilograms_per_cubic_meter"][-1]),
    )


def _readings(trace: FastsimDrive, start_ns: int) -> Iterator[Reading]:
    """Speed and height at the end of each second, power at its middle."""
    rows = zip(trace.seconds, trace.speed, trace.height, trace.power, strict=True)
    for index, (second, speed, height, power) in enumerate(rows):
        stamp_ns = start_ns + round(float(second) * NANOSECONDS)
        if index:
            middle_ns = stamp_ns - NANOSECONDS // 2
            yield BatteryReading(middle_ns, VOLTAGE, -float(power) / VOLTAGE)
        yield SpeedReading(stamp_ns, float(speed))
        yield AltitudeReading(stamp_ns, float(height))
