"""Logs of apps read with no flag: is every row accounted for, and do the readings agree?

The car says the same twice: the way by its odometer and by its speed, the energy by its state of
charge and by voltage times current. Only what lies between two gaps is compared.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import math
from pathlib import Path
import resource
import time

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.drives.evidence import Signal, at_times
from evpinn_ros.drives.sources import open_drive
from evpinn_ros.drives.table_drive import TableDrive
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading

LONGEST_STEP = 15.0  # s; what is longer is a gap
LEAST_WAY = 3000.0  # m by an odometer of whole kilometres
LEAST_CHARGE = 0.03  # of the battery, for a change of it that means something
WATT_HOURS = 3600.0
MEGABYTE = 1e6

FloatArray = NDArray[np.float64]

# Where apps tell the capacity: as remaining kWh, or in 1/10000 Ah; and power of their own.
REMAINING, AMPERE_HOURS, ODOMETER = "Battery DC Capacity (kWh)", "AHr", "Odo(km)"
OWN_POWER = "HV EV Battery Power (kW)"


@dataclass(frozen=True, slots=True)
class LogRead:
    """Readings found in a log."""

    name: str  # of the file
    rows: int  # below its header
    used: int  # rows that gave a reading
    empty: int  # rows without a cell of ours
    dropped: dict[str, int]  # what was left out
    readings: int  # how many
    seconds: float  # that reading took
    way: float  # by speed, m, where the odometer tells it too; NaN where it does not
    odometer: float  # m over the same time
    energy: float  # by voltage times current, J, where the state of charge tells it too
    charge: float  # J over the same time
    power: float  # by the log's own column of power, J; NaN where it has none
    same: float  # by voltage times current over the same time, J
    speed_by: str  # the column of speed


def read_log(path: Path) -> LogRead:
    """Read a log, and hold it against itself.

    Raises:
        InputError: it cannot be read.
    """
    begun = time.perf_counter()
    drive = open_drive(path)
    readings = list(drive.readings())
    took = time.perf_counter() - begun
    rows, used, dropped = drive.rows, drive.used, dict(drive.dropped)
    lost = sum(dropped.get(name, 0) for name in ("wrong_number_of_cells", "no_time"))
    way, odometer = _ways(readings, drive)
    energy, charge = _energies(readings, drive)
    return LogRead(
        path.name,
        rows,
        used,
        rows - used - lost,
        dropped,
        len(readings),
        took,
        way,
        odometer,
        energy,
        charge,
        *_own_power(readings, drive),
        next(column.name for column in drive.rules if column.quantity == "speed"),
    )


def _signal(pairs: Iterable[tuple[int, float]]) -> Signal:
    found = [(stamp, value) for stamp, value in pairs if math.isfinite(value)]
    stamps = np.array([stamp for stamp, _ in found], dtype=np.float64) / NANOSECONDS
    return Signal(stamps, np.array([value for _, value in found], dtype=np.float64))


def _integral(signal: Signal) -> tuple[FloatArray, FloatArray]:
    """The integral up to each time, and the number of gaps up to it."""
    steps = np.diff(signal.time)
    middle = 0.5 * (signal.value[1:] + signal.value[:-1])
    total = np.concatenate(([0.0], np.cumsum(middle * steps)))
    return total, np.concatenate(([0.0], np.cumsum(steps > LONGEST_STEP)))


def _between(signal: Signal, times: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """The integral of a signal between neighbouring times, and whether no gap is between."""
    total, gaps = _integral(signal)
    found = np.diff(np.interp(times, signal.time, total))
    inside = (times[:-1] >= signal.time[0]) & (times[1:] <= signal.time[-1])
    return found, inside & (np.diff(np.interp(times, signal.time, gaps)) == 0)


def _ways(readings: list[Reading], drive: TableDrive) -> tuple[float, float]:
    """Way by speed and by odometer, m, from one step of the odometer to another."""
    counted = drive.series([ODOMETER]).get(ODOMETER)
    speed = _signal((r.stamp_ns, r.speed) for r in readings if isinstance(r, SpeedReading))
    if counted is None or speed.time.size < 2:
        return math.nan, math.nan
    known = np.isfinite(counted.value) & (counted.value > 0)
    at, value = counted.time[known], counted.value[known]
    steps = np.flatnonzero(np.diff(value) > 0) + 1
    if steps.size < 2:
        return math.nan, math.nan
    # A phone without GPS writes 0 for a while: that is a gap as well, as is a stop.
    moving = Signal(speed.time[speed.value > 0], speed.value[speed.value > 0])
    if moving.time.size < 2:
        return math.nan, math.nan
    ways = _between(speed, at[steps])[0]
    whole = _between(moving, at[steps])[1]
    counted_m = 1000.0 * np.diff(value[steps])[whole]
    odometer = float(counted_m.sum())
    if odometer < LEAST_WAY:
        return math.nan, math.nan
    # The median of the pieces: a GPS that freezes falsifies some of them and no others.
    return float(np.median(ways[whole] / counted_m)) * odometer, odometer


def _own_power(readings: list[Reading], drive: TableDrive) -> tuple[float, float]:
    """Energy by the log's own column of power, and by ours over the same time, J."""
    own = drive.series([OWN_POWER]).get(OWN_POWER)
    power = _power(readings)
    if own is None or power is None:
        return math.nan, math.nan
    known = np.isfinite(own.value) & (own.time >= power.time[0]) & (own.time <= power.time[-1])
    own = Signal(own.time[known], own.value[known] * 1000)
    theirs, whole = _between(own, own.time)
    ours, also = _between(power, own.time)
    return float(theirs[whole & also].sum()), float(ours[whole & also].sum())


def _power(readings: list[Reading]) -> Signal | None:
    """Voltage at the times of current, times current, W; None where there is too little."""
    batteries = [r for r in readings if isinstance(r, BatteryReading)]
    voltage = _signal((r.stamp_ns, r.voltage) for r in batteries)
    current = _signal((r.stamp_ns, -r.current) for r in batteries)
    if current.time.size < 2 or voltage.time.size < 2:
        return None
    power = current.value * at_times(voltage, current.time)
    known = np.isfinite(power)
    return Signal(current.time[known], power[known]) if known.sum() > 1 else None


def _energies(readings: list[Reading], drive: TableDrive) -> tuple[float, float]:
    """Energy by voltage and current, and by what the car says that the battery holds, J."""
    power = _power(readings)
    if power is None:
        return math.nan, math.nan
    batteries = [r for r in readings if isinstance(r, BatteryReading)]
    voltage = _signal((r.stamp_ns, r.voltage) for r in batteries)
    held = _held(batteries, voltage, drive)
    if held is None:
        return math.nan, math.nan
    inside = (held.time >= power.time[0]) & (held.time <= power.time[-1])
    held = Signal(held.time[inside], held.value[inside])
    begins = np.flatnonzero(np.diff(held.time) > LONGEST_STEP) + 1
    ends = np.array([0, *begins, held.time.size])
    energy = charge = 0.0
    for first, last in zip(ends[:-1], ends[1:] - 1, strict=True):
        found, whole = _between(power, held.time[[first, last]])
        if last > first and whole[0]:
            energy += found[0]
            charge += held.value[first] - held.value[last]
    full = float(np.max(held.value)) / max(
        (r.state_of_charge for r in batteries if r.state_of_charge > 0), default=1.0
    )
    return (energy, charge) if abs(charge) >= LEAST_CHARGE * full else (math.nan, math.nan)


def _held(batteries: list[BatteryReading], voltage: Signal, drive: TableDrive) -> Signal | None:
    """Energy in the battery by its state of charge and its capacity, J."""
    columns = drive.series([REMAINING, AMPERE_HOURS])
    share = _signal((r.stamp_ns, r.state_of_charge) for r in batteries)
    share = Signal(share.time[share.value > 0], share.value[share.value > 0])
    if share.time.size < 2:
        return None
    if REMAINING in columns:
        # The car's kWh for its percents wander by a tenth within a drive: their median.
        ratio = columns[REMAINING].value / at_times(share, columns[REMAINING].time)
        return Signal(share.time, share.value * np.nanmedian(ratio) * 1000 * WATT_HOURS)
    if AMPERE_HOURS not in columns:
        return None
    capacity = float(np.nanmedian(columns[AMPERE_HOURS].value)) / 1e4
    mean = np.nan_to_num(at_times(voltage, share.time), nan=float(np.mean(voltage.value)))
    steps = np.diff(share.value) * 0.5 * (mean[1:] + mean[:-1]) * capacity * WATT_HOURS
    start = share.value[0] * mean[0] * capacity * WATT_HOURS
    return Signal(share.time, start + np.concatenate(([0.0], np.cumsum(steps))))


def write_large(path: Path, megabytes: float) -> None:
    """A table of a phone's making of so many megabytes."""
    header = "time,Vehicle speed (km/h),Battery voltage (V),Battery current (A),SOC (%)\n"
    with path.open("w") as file:
        size, row = file.write(header), 0
        while size < megabytes * MEGABYTE:
            lines = [
                f"{1.7e9 + 0.1 * (row + i):.1f},{50 + 40 * math.sin((row + i) / 90):.2f},"
                f"{380 - 9 * math.sin((row + i) / 70):.2f},{90 * math.sin((row + i) / 70):.3f},"
                f"{80 - (row + i) % 8000 / 200:.2f}\n"
                for i in range(10_000)
            ]
            size, row = size + file.write("".join(lines)), row + len(lines)


def measure_large(path: Path) -> tuple[float, float, float]:
    """Seconds that reading takes, of the clock and of the processor, and peak memory, MB."""
    begun, processor = time.perf_counter(), time.process_time()
    count = sum(1 for _ in open_drive(path).readings())
    took, processor = time.perf_counter() - begun, time.process_time() - processor
    assert count > 0
    return took, processor, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
