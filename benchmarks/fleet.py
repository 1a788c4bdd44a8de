"""Fleets of simulated cars: how quick on how many workers, how flat, and are the priors found.

Only the first few of many drives are different: these are linked under the names of many cars.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
import math
from multiprocessing import active_children
import os
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

import numpy as np

from evpinn_ros.estimation.evidence import LINEAR
from evpinn_ros.fleet.executor import LocalExecutor
from evpinn_ros.fleet.manifest import CarDrives, cars_by_folder
from evpinn_ros.fleet.population import COMBINATIONS, PopulationValue
from evpinn_ros.fleet.run import claimed, learn_fleet
from evpinn_ros.fleet.tables import FleetSummary, write_tables
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.simulation.drive import DriveKind
from evpinn_ros.simulation.output import write
from evpinn_ros.simulation.simulate import EPOCH_NS, simulate
from evpinn_ros.simulation.truth import LEAST_AUXILIARY
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.parameters import LIMITS

DRIVES_PER_CAR, DIFFERENT_CARS = 10, 4
DAY_NS = 86_400 * NANOSECONDS
MEAN_SHIFT, SPREAD = 0.5, 0.4  # of the known population, in sigmas of the vehicle file
DRAWN = ("eta", "mass", "c_rr", "c_d", "p_aux")  # of each car; mu follows its driver's braking
COMPARED = ("mass_over_eta", "c_d_over_eta", "c_rr", "p_aux")


@dataclass(frozen=True, slots=True)
class Scaling:
    """One run over a fleet on so many workers."""

    workers: int  # processes
    drives: int  # learned, fewer than there are if it was stopped
    start_s: float  # until each worker had done a car
    drives_per_s: float  # after that
    cpu_s: float  # of the processor a drive, start of the workers included
    # wall time per drive, in the first quarter after the start and in the last
    quarters_s: tuple[float, float]
    # of all processes, when a quarter of the cars was done and at the end
    rss_mb: tuple[float, float]
    tables_s: float  # to write the tables


@dataclass(frozen=True, slots=True)
class Recovered:
    """Distribution the cars were drawn from, logarithms but for p_aux, and its estimate."""

    name: str
    mean: float
    spread: float
    learned: PopulationValue

    @property
    def mean_off(self) -> float:
        """Error of the mean, in its sigmas."""
        return (self.learned.mean - self.mean) / self.learned.mean_std

    @property
    def spread_off(self) -> float:
        """Error of the spread, in its sigmas."""
        return (self.learned.spread - self.spread) / self.learned.spread_std


def many_drives(folder: Path, vehicle: Vehicle, drives: int, seconds: float) -> list[CarDrives]:
    """Write so many drives, a day apart, `DRIVES_PER_CAR` a car."""
    different = DIFFERENT_CARS * DRIVES_PER_CAR
    bags = [
        _bag(folder / f"{n}", vehicle, seconds, n, n % DRIVES_PER_CAR)
        for n in range(min(different, drives))
    ]
    for number in range(drives):
        link = folder / "cars" / f"{number // DRIVES_PER_CAR:05d}" / f"{number}.mcap"
        link.parent.mkdir(parents=True, exist_ok=True)
        os.link(bags[number % different], link)
    return cars_by_folder([str(folder / "cars")], vehicle)


def scaling(
    cars: list[CarDrives],
    out: Path,
    workers: int,
    clock: Callable[[], float],
    progress: Callable[[float], None],
    stopped: Callable[[], bool],
) -> Scaling | None:
    """Learn a whole fleet anew, and watch; None if it was stopped before there was much to see.

    `progress` takes the drives done.
    """
    begun, used = clock(), _cpu_s()
    done, memory = [], []
    for count in _learning(cars, out, workers, stopped):
        done.append(clock())
        memory.append(_rss_mb())
        progress(count * DRIVES_PER_CAR)
    if len(done) <= workers:
        return None
    written, used = clock(), _cpu_s() - used
    learned = write_tables(out, cars, {}).counts["learned"]
    steps = np.diff(done[workers - 1 :]) / DRIVES_PER_CAR
    quarter = max(1, len(steps) // 4)
    return Scaling(
        workers,
        learned,
        done[workers - 1] - begun,
        1.0 / float(steps.mean()),
        used / learned,
        (float(steps[:quarter].mean()), float(steps[-quarter:].mean())),
        (memory[workers - 1 + quarter], memory[-1]),
        clock() - written,
    )


def recovered(
    folder: Path,
    vehicle: Vehicle,
    cars: int,
    seconds: float,
    workers: int,
    seed: int,
    progress: Callable[[float], None],
    stopped: Callable[[], bool],
) -> list[Recovered]:
    """Drive cars of a known population, a drive each, and learn the population from them.

    `progress` takes twice the cars done, driven and learned; nothing is found if stopped.
    """
    rng = np.random.default_rng(seed)
    for number in range(cars):
        drive = simulate(
            DriveKind.MIXED, vehicle, seconds, seed + number, car=_drawn(vehicle, rng)
        )
        write(drive, folder / "known" / f"{number:05d}" / "drive")
        progress(number + 1)
        if stopped():
            return []
    fleet = cars_by_folder([str(folder / "known")], vehicle)
    for count in _learning(fleet, folder / "out", workers, stopped):
        progress(cars + count)
    return [] if stopped() else list(_compared(vehicle, write_tables(folder / "out", fleet, {})))


def _learning(
    fleet: list[CarDrives], out: Path, workers: int, stopped: Callable[[], bool]
) -> Iterator[int]:
    """Count of cars that are done, after each of them, until stopped."""
    with claimed(out), closing(learn_fleet(fleet, out, LocalExecutor(workers))) as outcomes:
        for count, outcome in enumerate(outcomes, start=1):
            if outcome.problem is not None:
                raise RuntimeError(outcome.problem)
            yield count
            if stopped():
                return


def _compared(vehicle: Vehicle, summary: FleetSummary) -> Iterator[Recovered]:
    population = summary.populations[vehicle.key]
    for name in COMPARED:
        parts = COMBINATIONS.get(name, {name: 1.0})
        means, spreads = zip(*(_known(vehicle, each) for each in parts), strict=True)
        mean = sum(sign * each for sign, each in zip(parts.values(), means, strict=True))
        yield Recovered(name, mean, math.hypot(*spreads), population.value(name))


def _known(vehicle: Vehicle, name: str) -> tuple[float, float]:
    """Mean and spread that a parameter is drawn from, logarithms but for p_aux."""
    prior = vehicle.priors[name]
    if name == LINEAR:
        return prior.value + MEAN_SHIFT * prior.std, SPREAD * prior.std / 2
    std = prior.std / prior.value
    return math.log(prior.value) + MEAN_SHIFT * std, SPREAD * std


def _drawn(vehicle: Vehicle, rng: np.random.Generator) -> dict[str, float]:
    car = {}
    for name in DRAWN:
        value = float(rng.normal(*_known(vehicle, name)))
        if name == LINEAR:
            car[name] = max(value, LEAST_AUXILIARY)
        else:
            car[name] = min(math.exp(value), LIMITS[name].upper)
    return car


def _bag(folder: Path, vehicle: Vehicle, seconds: float, seed: int, day: int) -> Path:
    start_ns = EPOCH_NS + day * DAY_NS
    write(simulate(DriveKind.URBAN, vehicle, seconds, seed, start_ns=start_ns), folder)
    return next(folder.glob("*.mcap"))


def _cpu_s() -> float:
    """Processor time of the workers that have ended."""
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _rss_mb() -> float:
    """Memory of this process and of its workers."""
    pids = ["self", *(str(child.pid) for child in active_children())]
    pages = sum(int(Path(f"/proc/{pid}/statm").read_text().split()[1]) for pid in pids)
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
