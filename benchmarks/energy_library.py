"""Speed of forecasts of many profiles, alone and beside FASTSim on drive cycles."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import csv
from functools import partial
from pathlib import Path
import time
from typing import Any, NamedTuple

import numpy as np

from benchmarks.fastsim_peer import AIR_DENSITY, fastsim_combined, run_fastsim
from evpinn_ros.common.errors import InputError
from evpinn_ros.energy.forecast import Profiles, forecast
from evpinn_ros.energy.power_model import combined_model, vehicle_model
from evpinn_ros.energy.quadrature import trapezoid
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.identifiable import Identifiable

BATCH, POINTS = 1000, 600
REPEATS = 5
CYCLES = ("udds", "hwfet", "us06")
NO_SIGMA = Identifiable(0.0, 0.0, 0.0, 0.0, 0.0)


class ForecastThroughput(NamedTuple):
    """Milliseconds of the processor for `BATCH` profiles of `POINTS` points, the quickest run."""

    vehicle_file_ms: float
    learned_ms: float
    torch_ms: float
    torch_gradient_ms: float


class CycleRow(NamedTuple):
    """One drive cycle, flat: energies in J."""

    cycle: str  # its name
    distance_m: float  # its length
    fastsim_j: float  # of its Model 3
    # of ours with the mass, road load, auxiliary power and usual efficiency of its
    same_car_j: float
    vehicle_file_j: float  # of our Model 3 as the vehicle file has it
    fastsim_us: float  # for one step
    ours_us: float  # for one step of a batch, the learned model


def measure_throughput(vehicle: Vehicle) -> ForecastThroughput:
    """Time the library in the calling thread alone."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    profiles = hilly_profiles(BATCH, POINTS)
    learned = vehicle_model(vehicle)
    tensors = Profiles(*(torch.as_tensor(array) for array in profiles))

    def gradient() -> None:
        speed = tensors.speed.clone().requires_grad_()
        energy, sigma = forecast(tensors._replace(speed=speed), vehicle, learned)
        (energy + sigma).sum().backward()

    try:
        return ForecastThroughput(
            _quickest_ms(lambda: forecast(profiles, vehicle)),
            _quickest_ms(lambda: forecast(profiles, vehicle, learned)),
            _quickest_ms(lambda: forecast(tensors, vehicle, learned)),
            _quickest_ms(gradient),
        )
    finally:
        torch.set_num_threads(threads)


def compare_cycles(folder: Path, vehicle: Vehicle) -> Iterator[CycleRow]:
    """Our forecasts beside FASTSim's Model 3 over the cycles in a folder.

    Raises:
        InputError: a cycle is missing.
    """
    same = combined_model(fastsim_combined(), NO_SIGMA, vehicle)
    learned = vehicle_model(vehicle)
    for name in CYCLES:
        time_s, speed = read_cycle(folder / f"{name}.csv")
        peer = run_fastsim(time_s, speed, REPEATS)
        one = Profiles(time_s, speed[None])
        many = Profiles(time_s, np.tile(speed, (BATCH, 1)))
        ours_ms = _quickest_ms(partial(forecast, many, vehicle, learned))
        yield CycleRow(
            cycle=name,
            distance_m=trapezoid(speed, time_s),
            fastsim_j=peer.energy_j,
            same_car_j=float(forecast(one, vehicle, same, air_density=AIR_DENSITY).energy[0]),
            vehicle_file_j=float(forecast(one, vehicle).energy[0]),
            fastsim_us=1e6 * peer.seconds_per_step,
            ours_us=1e3 * ours_ms / (BATCH * (len(time_s) - 1)),
        )


def hilly_profiles(batch: int, points: int) -> Profiles:
    """Candidates like an optimiser's: one trip over hills, driven in many ways."""
    random = np.random.default_rng(0)
    time_s = np.arange(float(points))
    basis = np.sin(np.outer(np.arange(1, 9), time_s) * np.pi / 120.0)
    speed = 15.0 + random.normal(0.0, 2.0, (batch, 8)) @ basis
    speed = np.clip(speed, 0.0, 38.0)
    return Profiles(time_s, speed, 20.0 * np.sin(np.cumsum(speed, axis=1) / 700.0))


def read_cycle(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Time, s, and speed, m/s, of a drive cycle with the columns cycSecs and cycMps.

    Raises:
        InputError: no such file, or no such columns.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [(float(row["cycSecs"]), float(row["cycMps"])) for row in csv.DictReader(file)]
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except (KeyError, ValueError) as error:
        raise InputError(f"{path}: no drive cycle with columns cycSecs and cycMps") from error
    time_s, speed = np.array(rows).T
    return time_s, speed


def _quickest_ms(work: Callable[[], Any]) -> float:
    times = []
    for _ in range(REPEATS):
        begin = time.thread_time()
        work()
        times.append(time.thread_time() - begin)
    return 1e3 * min(times)
