"""Years in short: many hours of driving through one chain, with memory and time watched."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import cycle
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.estimation.estimator import EstimatorSettings
from evpinn_ros.estimation.worker import Clock, InlineWorker
from evpinn_ros.replays.chain import Chain
from evpinn_ros.signals.readings import NANOSECONDS, Reading
from evpinn_ros.simulation.drive import DriveKind
from evpinn_ros.simulation.simulate import EPOCH_NS, simulate
from evpinn_ros.vehicle.files import load_vehicle

VEHICLE = "tesla_model_3_lr"
HOUR = 3600  # s
PAUSE = 900  # s that the car is parked after each hour
SEED = 5000
PIECE = 1000  # readings


class Hour(NamedTuple):
    """One hour of driving."""

    readings: int  # that went through the chain
    resident_mb: float  # memory of the process at its end
    us_per_reading: float  # processor time for one, all learning included
    energy: float  # counted since the first hour, J

    @property
    def energy_kwh(self) -> float:
        """Energy counted since the first hour, kWh."""
        return self.energy / 3.6e6


def soak(
    hours: int, clock: Clock, progress: Callable[[float], None], duration: float = HOUR
) -> Iterator[Hour]:
    """Drive one chain for hours, each of another drive, with a pause after it.

    The clock is processor time, s; `progress` takes the seconds done; an hour lasts `duration`, s.

    Raises:
        InputError: no /proc here.
    """
    chain = Chain(load_vehicle(VEHICLE), EstimatorSettings(), InlineWorker(clock))
    context = get_context("spawn")
    receiving, sending = context.Pipe(duplex=False)
    # Simulated elsewhere: the memory that is watched shall be the chain's.
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
    """Send one car for hours, with a pause after each: pieces of readings, an empty one to end."""
    vehicle, car = load_vehicle(VEHICLE), None
    for hour, kind in zip(range(hours), cycle(DriveKind), strict=False):
        start_ns = EPOCH_NS + round(hour * (duration + PAUSE) * NANOSECONDS)
        drive = simulate(kind, vehicle, duration, SEED + hour, car=car, start_ns=start_ns)
        car = drive.car
        for begin in range(0, len(drive.readings), PIECE):
            sending.send(drive.readings[begin : begin + PIECE])
        sending.send(())


def _add_readings(chain: Chain, readings: Sequence[Reading]) -> None:
    for reading in readings:
        for _ in chain.add_reading(reading):
            pass


def resident_mb(process: int | str) -> float:
    """Memory of a process that is in use, MB.

    Raises:
        InputError: no such process any more, or no Linux.
    """
    try:
        text = Path(f"/proc/{process}/status").read_text()
    except OSError as error:
        raise InputError(f"the process ended, or this is no Linux: {error}") from error
    (line,) = (line for line in text.splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) * 1024 / 1e6


def memory_growth(hours: Sequence[Hour]) -> float:
    """Largest memory after the first hour, relative to it; 0.02 is two percent more."""
    return max(hour.resident_mb for hour in hours) / hours[0].resident_mb - 1


def time_drift(hours: Sequence[Hour]) -> float:
    """Time of a reading in the last quarter relative to the first; hours of each kind in both."""
    times = np.array([hour.us_per_reading for hour in hours])
    part = max(len(times) // 4, 1)
    return float(np.median(times[-part:]) / np.median(times[:part]) - 1)
