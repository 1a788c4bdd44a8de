"""Size of a vehicle without a vehicle file, by its first minutes of motion.

`generic` is a passenger car of two tonnes. Battery energy of intervals of ten seconds is linear in
kinetic energy gained and lost, distance, the cube of the speed and time, and each coefficient
scales with the size of the vehicle (`estimation.size`). So each size gives a Gaussian prior of the
coefficients, and the data a likelihood of each size. Passenger cars have sizes near 1 and similar
coefficients; other vehicles have any size and shape. A vehicle of another size takes the place of
`generic` only if the data contradict every passenger car.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.signals.block import Block, joined
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    SpeedReading,
    drawn_power,
)
from evpinn_ros.core.signals.track import LATER
from evpinn_ros.core.vehicle.files import AREA_POWER
from evpinn_ros.core.vehicle.physics import GRAVITY, STANDSTILL_SPEED

CAR_MASS = 2040.0  # kg, of `generic`, whose size is 1
MASSES = (20.0, 20_000.0)  # kg, of vehicles with a battery
SIZES = np.geomspace(MASSES[0] / CAR_MASS, MASSES[1] / CAR_MASS, 139)  # 5 % apart
INTERVAL = 10  # s
LONGEST_GAP = 6.0  # s between readings
LONGEST_DRIVE = 100_000  # s, beyond which stamps are wrong
LEAST_INTERVALS = 18
CAR_INTERVALS = 36  # after which a passenger car is believed to be one
MOST_INTERVALS, MOST_READINGS = 180, 300_000  # after which the size is settled
FIRST_LOOK_NS, LATER_LOOK = 240 * NANOSECONDS, 1.2  # first look into a drive; next over last
LIKELY = math.log(1e3)  # log odds from which on another size is taken
# Distance of the logarithm from a car. Nearer vehicles (vans, city cars, three-wheelers of 800 kg)
# are within reach of its priors: a three-wheeler of 800 kg that was taken for one of 107 kg gained
# on whole drives (CRPS 13.7 to 11.3) what it lost on 200 s (8.9 to 11.7).
FAR = math.log(3.5)
SURE = 0.5  # 1-sigma of the logarithm; more is two sizes at once, early in a drive
ALIKE = 4.0  # neighbouring intervals that count as one, because their errors are correlated
NOISE_FLOOR = 0.05  # of the root mean square energy of an interval
# Coefficients of a car of two tonnes, by `generic` with eta 0.88: kinetic energy gained, kinetic
# energy lost (given back), weight times distance, drag, time.
CAR = np.array([2318.0, -1400.0, 18.0, 0.90, 500.0])
CAR_SHARE = np.array([0.15, 0.5, 0.4, 0.35, 6.0])  # relative 1-sigma; 3 kW of heating, say
CAR_STD = 0.28  # 1-sigma of the logarithm of a car's size
# Relative 1-sigma of robots, three-wheelers, trucks, buses, and race cars, whose wings drag.
ANY_SHARE = np.array([0.3, 1.0, 0.8, 2.0, 1.5])
DRAG, TERMS = 3, len(ANY_SHARE)
MOST_ENERGY = 1e12  # J of an interval
VOLTAGE, VOLTAGE_POWER, VOLTAGE_STD, CAR_VOLTAGE_STD = 360.0, 0.5, 0.6, 0.3  # std of logarithms


class Size(NamedTuple):
    """Size of a vehicle over that of a passenger car.

    Attributes:
        value: mass over `CAR_MASS`.
        std: 1-sigma of its logarithm.
        log_odds: against a passenger car of unknown mass.
    """

    value: float
    std: float
    log_odds: float

    @property
    def is_another(self) -> bool:
        """True if no passenger car is of this size."""
        far = abs(math.log(self.value)) > FAR
        return far and self.log_odds > LIKELY and self.std < SURE


class Intervals(NamedTuple):
    """Intervals of one drive or more.

    Attributes:
        rows: terms, shape (n, `TERMS`).
        energy: of the battery, J, shape (n,).
        volts: median voltage, NaN without.
    """

    rows: Annotated[np.ndarray, Range(0.0, MOST_ENERGY, shape=(None, TERMS))]
    energy: Annotated[np.ndarray, Range(-MOST_ENERGY, MOST_ENERGY)]
    volts: Annotated[float, Range(-MOST_ENERGY, MOST_ENERGY, unknown=True)]

    @staticmethod
    def of_drives(drives: list[Intervals]) -> Intervals:
        """The intervals of drives of one vehicle, with the voltage of the newest that has any."""
        rows, energy, volts = zip(*drives, strict=True)
        measured = [volt for volt in volts if not math.isnan(volt)]
        newest = (math.nan, *measured)[-1]
        return Intervals(np.concatenate(rows), np.concatenate(energy), newest)


class Sizing:
    """Estimates the size of a vehicle during its first drives, until it is settled.

    Attributes:
        blocks: of the drive so far.
        over: True once the size is settled.
    """

    def __init__(self, earlier: Intervals | None = None) -> None:
        """Go on from the intervals of earlier drives; ValueError if they do not fit together."""
        self.over = False
        self._earlier: list[Intervals] = []
        if earlier is not None:
            if len(earlier.rows) != len(earlier.energy):
                raise ValueError("intervals for the size: an energy is missing")
            self._earlier.append(earlier._replace(rows=earlier.rows.reshape(-1, TERMS)))
        self._begin()

    def _begin(self) -> None:
        self.blocks: list[Block] = []
        self._begin_ns: int | None = None
        self._look_ns = 0

    def begin_drive(self) -> None:
        """Go on with another drive of the same vehicle."""
        self._earlier.append(_intervals(joined(self.blocks)))
        self._begin()

    def intervals(self) -> Intervals:
        """The intervals so far, of all drives."""
        return Intervals.of_drives([*self._earlier, _intervals(joined(self.blocks))])

    def due_ns(self, block: Block) -> int:
        """First stamp in a block, in order of stamps, at which to `look`; `LATER` if none."""
        stamps = block.stamps()
        if self._begin_ns is None and len(stamps):
            self._begin_ns = int(stamps[0])
            self._look_ns = self._begin_ns + FIRST_LOOK_NS
        place = int(stamps.searchsorted(self._look_ns))
        if place == len(stamps):
            return LATER
        passed_ns = int(stamps[place]) - (self._begin_ns or 0)
        self._look_ns = (self._begin_ns or 0) + int(LATER_LOOK * passed_ns)
        return int(stamps[place])

    def look(self) -> Size | None:
        """The size, if it is not that of a passenger car; None while unknown."""
        intervals = self.intervals()
        size, count = size_of(intervals), len(intervals.energy)
        is_car = size is not None and size.log_odds < 0.0 and count >= CAR_INTERVALS
        is_another = size is not None and size.is_another
        spent = count > MOST_INTERVALS or sum(b.length for b in self.blocks) > MOST_READINGS
        self.over = is_another or is_car or spent
        return size if is_another else None


def size_of(intervals: Intervals) -> Size | None:
    """Size of a vehicle by its intervals; None while they are few."""
    rows, energy, volts = intervals
    if len(energy) < LEAST_INTERVALS:
        return None
    solution = np.linalg.lstsq(rows, energy, rcond=None)[0]
    residual = energy - rows @ solution
    spread = 1.4826 * np.median(np.abs(residual)) * math.sqrt(len(energy) / (len(energy) - 5))
    noise = ALIKE * (spread**2 + NOISE_FLOOR**2 * np.mean(energy**2))
    inside = np.abs(residual) < 4.0 * math.sqrt(noise)
    data = rows[inside].T @ rows[inside] / noise, rows[inside].T @ energy[inside] / noise
    log_volts, logs = math.log(volts / VOLTAGE), np.log(SIZES)
    means = [size * _shaped(size) for size in SIZES]
    voltage = _normal(log_volts, VOLTAGE_POWER * logs, VOLTAGE_STD)
    scores = np.array([_evidence(*data, mean, ANY_SHARE) for mean in means]) + voltage
    cars = np.array([_evidence(*data, mean, CAR_SHARE) for mean in means])
    car = _log_mean(cars, _normal(logs, 0.0, CAR_STD)) + _normal(log_volts, 0.0, CAR_VOLTAGE_STD)
    weights = np.exp(scores - scores.max())
    weights /= weights.sum()
    mean = float(weights @ logs)
    std = math.sqrt(float(weights @ (logs - mean) ** 2))
    return Size(math.exp(mean), std, float(_log_mean(scores, np.zeros(len(SIZES))) - car))


def _log_mean(scores: np.ndarray, weights: np.ndarray) -> float:
    """Logarithm of the weighted mean of likelihoods; all arguments are logarithms."""
    return float(np.logaddexp.reduce(scores + weights) - np.logaddexp.reduce(weights))


def _shaped(size: float) -> np.ndarray:
    """Coefficients of a vehicle of this size, over the size."""
    coefficients = CAR.copy()
    coefficients[DRAG] *= size ** (AREA_POWER - 1.0)
    return coefficients


def _evidence(
    information: np.ndarray, product: np.ndarray, mean: np.ndarray, share: np.ndarray
) -> float:
    """Logarithm of the likelihood of energies, without the terms that all priors share.

    `information` is X'X over the variance of the noise, `product` X'y over it.
    """
    scale = np.abs(mean) * share
    precision = np.eye(len(mean)) + scale[:, None] * information * scale
    away = scale * (product - information @ mean)
    gain = float(away @ np.linalg.solve(precision, away))
    fit = float(mean @ information @ mean - 2.0 * mean @ product)
    return 0.5 * (gain - fit - float(np.linalg.slogdet(precision)[1]))


def _normal(value: Any, mean: Any, std: float) -> Any:
    return -0.5 * ((value - mean) / std) ** 2 - math.log(std)


def _intervals(readings: Block) -> Intervals:
    nothing = Intervals(np.empty((0, TERMS)), np.empty(0), math.nan)
    speeds, battery = readings.of_kind(SpeedReading), readings.of_kind(BatteryReading)
    altitudes = readings.of_kind(AltitudeReading)
    speed = np.column_stack((speeds.stamps, np.abs(speeds.values[0])))
    stamps, (voltage, current, *_) = battery.stamps.astype(float), battery.values
    volts = np.flatnonzero(np.isfinite(voltage))
    use = np.isfinite(current)
    if min(len(speed), len(volts), int(np.count_nonzero(use))) < 2:
        return nothing
    paired = np.interp(stamps[use], stamps[volts], voltage[volts])  # each may come by itself
    power = np.column_stack((stamps[use], drawn_power(paired, current[use])))
    height = np.column_stack((altitudes.stamps, altitudes.values[0]))
    begin_ns = max(speed[0, 0], power[0, 0])
    speed, power = _seconds(speed, begin_ns), _seconds(power, begin_ns)
    count = int((min(speed[-1, 0], power[-1, 0]) - 1.0) // INTERVAL)
    if not 0 < count * INTERVAL < LONGEST_DRIVE:
        return nothing
    second = np.arange(count * INTERVAL + 1.0)
    drawn = np.diff(_integral(power, second[::INTERVAL]))
    way = _integral(speed, np.concatenate((second - 0.5, second[-1:] + 0.5)))
    at = np.abs(np.diff(way))  # m/s, mean of the second around
    step = (at[1:] + at[:-1]) / 2.0
    gain = np.diff(at**2) / 2.0
    if len(height) > 1:
        levels = _seconds(height, begin_ns)
        climb = np.diff(np.interp(second[::INTERVAL], *levels.T))
        gain = gain + GRAVITY * np.repeat(climb / INTERVAL, INTERVAL)
    columns = (np.maximum(gain, 0.0), np.maximum(-gain, 0.0), GRAVITY * step, 0.6 * step**3,
               np.ones_like(step))  # fmt: skip
    rows = np.stack([column.reshape(count, INTERVAL).sum(axis=1) for column in columns], axis=1)
    moved = step.reshape(count, INTERVAL).sum(axis=1) > STANDSTILL_SPEED * INTERVAL
    use = moved & _whole(speed[:, 0], second) & _whole(power[:, 0], second)
    return Intervals(rows[use], drawn[use], float(np.median(paired)))


def _seconds(series: np.ndarray, begin_ns: float) -> np.ndarray:
    """A series by its time, s since the begin, in order."""
    ordered = series[np.argsort(series[:, 0], kind="stable")].astype(float)
    ordered[:, 0] = (ordered[:, 0] - begin_ns) / NANOSECONDS
    return ordered


def _integral(series: np.ndarray, at: np.ndarray) -> np.ndarray:
    time, value = series.T
    whole = np.concatenate(([0.0], np.cumsum(np.diff(time) * (value[1:] + value[:-1]) / 2.0)))
    return np.asarray(np.interp(at, time, whole))


def _whole(time: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Which intervals have no gap between readings."""
    gaps = np.flatnonzero(np.diff(time) > LONGEST_GAP)
    count = (len(second) - 1) // INTERVAL
    whole = np.ones(count, dtype=bool)
    for gap in gaps:
        first, last = np.clip(time[gap : gap + 2] // INTERVAL, 0, count).astype(int)
        whole[first : last + 1] = False
    return whole
