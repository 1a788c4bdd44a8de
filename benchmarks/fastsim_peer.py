"""FASTSim 3 (NREL; `fastsim` on PyPI), a simulator of whole vehicles, on drive cycles.

Optional, and no extra of this package: fastsim 3.1 wants msgpack 1.2.1 or newer, python-can's
multicast bus wants 1.1. It runs with 1.1 too: `pip install --no-deps fastsim pandas plotly polars
polars-runtime-32`.

It steps through a cycle and models what ours does not: limits of motor, battery and tyres, so that
a cycle may be missed; the motor's efficiency by load, the battery's, the gearbox's; state of
charge; cabin and battery temperatures with a heat pump. Ours has what was learned of one car.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.vehicle.identifiable import Identifiable

MODEL_3 = "2022 Tesla Model 3 RWD thrml.yaml"  # comes with fastsim
EFFICIENCY = 0.9 * 0.98  # of its motor, 0.84 to 0.95 by load, and of its gearbox
AIR_DENSITY = 1.2  # kg/m^3, its default


class FastsimRun(NamedTuple):
    """Energy at the battery's terminals, J, and seconds of the processor for each step."""

    energy_j: float
    seconds_per_step: float


def fastsim_version() -> str | None:
    """Version of the installed fastsim, None if there is none."""
    try:
        return version("fastsim")
    except PackageNotFoundError:
        return None


def fastsim_combined() -> Identifiable:
    """Its Model 3 as one of ours, with one efficiency both ways."""
    fastsim = import_module("fastsim")
    found = fastsim.Vehicle.from_resource(MODEL_3).to_dict()
    chassis, mass = found["chassis"], found["mass_kilograms"]
    drag_area = chassis["drag_coef"] * chassis["frontal_area_square_meters"]
    return Identifiable(
        mass / EFFICIENCY,
        drag_area / EFFICIENCY,
        chassis["wheel_rr_coef"],
        EFFICIENCY**2,
        found["pwr_aux_base_watts"],
    )


def run_fastsim(time_s: np.ndarray, speed: np.ndarray, repeats: int) -> FastsimRun:
    """Drive its Model 3 over a flat cycle; speed in m/s. The quickest of some repeats is timed.

    No history is kept, for that is quicker.
    """
    fastsim = import_module("fastsim")
    vehicle = fastsim.Vehicle.from_resource(MODEL_3)
    vehicle.set_save_interval(None)
    cycle = fastsim_cycle(time_s, speed, np.zeros_like(speed))
    seconds = []
    for _ in range(repeats):
        drive = fastsim.SimDrive(vehicle, cycle)
        begin = time.thread_time()
        drive.run()
        seconds.append(time.thread_time() - begin)
    battery = drive.to_dict()["veh"]["pt_type"]["BEV"]["res"]["state"]
    return FastsimRun(battery["energy_out_electrical_joules"], min(seconds) / (len(time_s) - 1))


def fastsim_cycle(time_s: np.ndarray, speed: np.ndarray, slope: np.ndarray) -> Any:
    """A cycle of its own: speeds in m/s, and the slope of the road up to each."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "cycle.csv"
        rows = np.column_stack((time_s, speed, slope))
        names = "time_seconds,speed_meters_per_second,grade"
        np.savetxt(file, rows, delimiter=",", header=names, comments="")
        return import_module("fastsim").Cycle.from_file(str(file))
