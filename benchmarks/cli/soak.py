"""`evpinn bench soak`: measures memory and time over hours of driving in one run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import cycle
from multiprocessing import get_context
from multiprocessing.connection import Connection
import time
from typing import Annotated, NamedTuple

import numpy as np
import typer

from benchmarks.cli.output import figures_table, json_as_it_comes, table_of
from benchmarks.processes import resident_mb
from evpinn_ros.cli.console import progress_bar, show
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import Clock, InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import EPOCH_NS, simulate

VEHICLE = "tesla_model_3_lr"
HOUR = 3600  # s
PAUSE = 900  # s that the car is parked after each hour
SEED = 5000
PIECE = 1000  # readings


class Hour(NamedTuple):
    """One hour of driving."""

    readings: int  # that went through the chain
    resident_mb: float  # memory of the process at the end
    us_per_reading: float  # processor time, learning included
    energy: float  # counted since the first hour, J

    @property
    def energy_kwh(self) -> float:
        """Energy counted since the first hour, kWh."""
        return self.energy / 3.6e6


def drive_hours(
    hours: int, clock: Clock, progress: Callable[[float], None], duration: float = HOUR
) -> Iterator[Hour]:
    """Drive one chain for hours, each a drive of its own with a pause after it.

    `clock` is processor time, s; `progress` takes the driven seconds; an hour lasts `duration`, s.

    Raises:
        InputError: there is no /proc.
    """
    chain = Chain(load_vehicle(VEHICLE), EstimatorSettings(), InlineWorker(clock))
    context = get_context("spawn")
    receiving, sending = context.Pipe(duplex=False)
    # Simulated in another process, so that the measured memory is the chain's.
    elsewhere = context.Process(target=_simulate, args=(sending, hours, duration), daemon=True)
    elsewhere.start()
    sending.close()
    with receiving:
        for hour in range(hours):
            count, seconds = 0, 0.0
            while piece := receiving.recv():
                begin = clock()
                _add_readings(chain, piece)
                seconds += clock() - begin
                count += len(piece)
                progress((piece[-1].stamp_ns - EPOCH_NS) / NANOSECONDS - hour * PAUSE)
            energy = chain.account.state.consumed
            yield Hour(count, resident_mb("self"), 1e6 * seconds / count, energy)
    elsewhere.join()


def _simulate(sending: Connection, hours: int, duration: float) -> None:
    """Send pieces of the readings of each hour, followed by an empty piece."""
    vehicle, car = load_vehicle(VEHICLE), None
    for hour, kind in zip(range(hours), cycle(DriveKind), strict=False):
        start_ns = EPOCH_NS + round(hour * (duration + PAUSE) * NANOSECONDS)
        drive = simulate(kind, vehicle, duration, SEED + hour, car=car, start_ns=start_ns)
        car = drive.car
        for begin in range(0, len(drive.readings), PIECE):
            sending.send(drive.readings[begin : begin + PIECE])
        sending.send(())


def _add_readings(chain: Chain, readings: Sequence[Reading]) -> None:
    for _ in chain.add_readings(readings):
        pass


def memory_growth(hours: Sequence[Hour]) -> float:
    """Largest memory after the first hour, relative to it; 0.02 is two percent more."""
    return max(hour.resident_mb for hour in hours) / hours[0].resident_mb - 1


def time_drift(hours: Sequence[Hour]) -> float:
    """Time of a reading in the last quarter relative to the first; hours of each kind in both."""
    times = np.array([hour.us_per_reading for hour in hours])
    part = max(len(times) // 4, 1)
    return float(np.median(times[-part:]) / np.median(times[:part]) - 1)


COLUMNS = (
    ("hour", "{0}"),
    ("readings", "{1.readings}"),
    ("memory", "{1.resident_mb:.1f} MB"),
    ("per reading", "{1.us_per_reading:.0f} us"),
    ("energy so far", "{1.energy_kwh:.2f} kWh"),
)


def soak(
    hours: Annotated[int, typer.Option(min=2, help="Hours of driving through one chain.")] = 24,
    json_file: JsonOption = None,
) -> None:
    """Drive for a day in one run, and measure memory and time.

    Example: evpinn bench soak --hours 24 --json out/soak.json
    """
    limit_blas_threads()
    rows: list[Hour] = []
    with json_as_it_comes(json_file, lambda: {"hours": [row._asdict() for row in rows]}) as keep:
        try:
            with progress_bar("driving", total=hours * HOUR) as progress:
                for hour in drive_hours(hours, time.process_time, progress):
                    rows.append(hour)
                    keep()
        finally:
            numbered = list(enumerate(rows, start=1))
            show(table_of("One chain, hour by hour", numbered, COLUMNS, left=0))
    figures = [
        ("memory, largest after the first hour", f"{memory_growth(rows):+.2%}", "2 %"),
        ("time of a reading, last quarter to first", f"{time_drift(rows):+.2%}", "0"),
    ]
    show(figures_table("For years", figures))
