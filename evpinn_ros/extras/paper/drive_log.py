"""A recorded drive in the form of the paper: arrays of time, speed, acceleration and power."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evpinn_ros.common.arrays import chosen_rows
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, SpeedReading
from evpinn_ros.core.signals.reorder import in_order
from evpinn_ros.core.signals.road import GradeSource
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings
from evpinn_ros.core.signals.time_jump import Jump, StampGuard
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.logs.read_options import READ_DEFAULTS, ReadOptions
from evpinn_ros.logs.sources import open_source

MIN_SAMPLES = 100
# Future samples in the local quadratic of `signals.kinematics`: dv/dt of a finished log need not
# be causal. The paper does not say how it differentiates speed.
SMOOTHING_AHEAD = 0.3  # s
DELAYS = np.linspace(-0.4, 0.4, 41)  # s, candidates
LEAST_GAIN = 0.01  # share of the unexplained variance that a delay must remove to be used
MOST_UNEXPLAINED = 0.5  # share of the variance of power


class DriveLog(NamedTuple):
    """Aligned samples of a drive, float64, shape (n,) each."""

    time: np.ndarray  # s since the first sample
    speed: np.ndarray  # m/s
    acceleration: np.ndarray  # m/s^2, from a local quadratic
    power: np.ndarray  # battery power, V times I (eq. 11), W


class ReadLog(NamedTuple):
    """A log as read."""

    drive: DriveLog  # its samples
    delay: float  # removed delay of speed behind power, s
    dropped: Mapping[str, int]  # counts of unused readings, by reason


def read_drive_log(path: Path, vehicle: Vehicle, options: ReadOptions = READ_DEFAULTS) -> ReadLog:
    """Read a log without the delay of speed and the readings that the estimator would drop.

    A delay of 50 ms changes C_rr by several percent.

    Raises:
        InputError: the log is unreadable, its time goes back, or it has fewer than `MIN_SAMPLES`.
    """
    drive, dropped = _read(path, vehicle, options, 0.0)
    delay = speed_delay(drive, vehicle)
    if delay != 0.0:
        drive, dropped = _read(path, vehicle, options, delay)
    return ReadLog(drive, delay, dropped)


def speed_delay(log: DriveLog, vehicle: Vehicle) -> float:
    """Delay of speed, s, with the best least-squares fit of eq. 21; 0 if not clear."""
    left = np.array([_unexplained(log, vehicle, delay) for delay in DELAYS])
    best = int(np.argmin(left))
    without = float(np.interp(0.0, DELAYS, left))
    decided = left[best] < MOST_UNEXPLAINED and left[best] < (1.0 - LEAST_GAIN) * without
    if best in (0, len(DELAYS) - 1) or not decided:
        return 0.0
    before, least, after = left[best - 1 : best + 2]
    bend = before - 2.0 * least + after
    offset = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return round(float(DELAYS[best] + offset * (DELAYS[1] - DELAYS[0])), 3)  # to the millisecond


def _unexplained(log: DriveLog, vehicle: Vehicle, delay: float) -> float:
    """Share of the variance of power unexplained by eq. 21, with speed `delay` s earlier."""
    inside = (log.time - DELAYS[-1] >= log.time[0]) & (log.time - DELAYS[0] <= log.time[-1])
    _, speed, acceleration, _ = chosen_rows(log, inside)
    power = np.interp(log.time[inside] - delay, log.time, log.power)
    braking = acceleration < vehicle.beta
    kinetic = speed * acceleration
    terms = (np.ones_like(speed), speed, speed**3, kinetic * braking, kinetic * ~braking)
    columns = np.stack(terms, axis=1)
    coefficients, *_ = np.linalg.lstsq(columns, power, rcond=None)
    variance = float(np.var(power))
    return (
        float(np.mean((power - columns @ coefficients) ** 2)) / variance if variance > 0.0 else 1.0
    )


def _read(
    path: Path, vehicle: Vehicle, options: ReadOptions, delay: float
) -> tuple[DriveLog, dict[str, int]]:
    settings = StreamSettings(smoothing_lag=SMOOTHING_AHEAD, grade_source=GradeSource.NONE)
    stream, guard = SampleStream(settings, vehicle.air_density), StampGuard(SpeedReading)
    source = open_source(path, vehicle, options)
    earlier_ns = round(delay * NANOSECONDS)
    readings = []
    for item in (item for block in source.blocks() for item in guard.follow(block)):
        if isinstance(item, Jump):
            raise InputError(f"{path}: time goes back within the log; split it there")
        for reading in item.readings():
            if isinstance(reading, SpeedReading):  # without its delay
                reading = replace(reading, stamp_ns=reading.stamp_ns - earlier_ns)
            readings.append(reading)
    samples, power, *_ = stream.add(in_order(Block.of(readings))).measured
    dropped = {**source.dropped, **guard.dropped, **stream.dropped}
    if samples.size < MIN_SAMPLES:
        why = ", ".join(f"{count} {reason}" for reason, count in dropped.items())
        raise InputError(
            f"{path}: {samples.size} samples with speed and power, the experiment needs "
            f"{MIN_SAMPLES}{f' (dropped: {why})' if why else ''}"
        )
    time = (samples.stamp_ns - samples.stamp_ns[0]) / NANOSECONDS
    return DriveLog(time, samples.speed, samples.acceleration, power), dropped
