"""The core with one part left out: what each part is worth without the battery.

Drives of real cars become intervals once. Each variant of the core then predicts every drive from
what the ones before taught, and 200 s stretches within the drives, battery hidden; both are scored
by error, coverage of the 90 % interval and likelihood (of the error over the gross energy, heavy
tails cut off at 4 sigmas). A variant is the core with some of its constants replaced.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
import math
from typing import Any

import numpy as np

from evpinn_ros.bench.unseen.drives import load_car
from evpinn_ros.estimation import car_filter, car_state
from evpinn_ros.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.estimation.car_filter import CarFilter
from evpinn_ros.estimation.car_state import State
from evpinn_ros.estimation.gaussian import replace_states
from evpinn_ros.signals.interval import Interval
from evpinn_ros.signals.stream import SampleStream, StreamSettings
from evpinn_ros.vehicle.files import Vehicle

CARS = ("model3", "i3", "i3_speed", "e208", "leaf2013")
STRETCH, STEP, FIRST = 195.0, 200.0, 250.0  # s: hidden, between two, before the first
MOST_SIGMAS = 4.0
NOTHING = 1e-6


@dataclass(frozen=True, slots=True)
class Variant:
    """Constants of `car_filter`, and entries of the tables of `car_state`, to be replaced."""

    name: str
    constants: Mapping[str, Any] = field(default_factory=dict)
    priors: Sequence[State] = ()
    drives: Sequence[State] = ()


ONE_SCALE = {
    "FORCES": (0.002,),
    "LOADS": (150.0,),
    "SLOPES": (0.008,) * 3,
    "HEIGHT_ERRORS": (1.5,) * 3,
}
STARTS = (State.COLD_START, State.HOT_START)
VARIANTS = (
    Variant("whole"),
    Variant(
        "one scale of road and load",
        ONE_SCALE,
    ),
    Variant("no unseen slope", {"SLOPES": (NOTHING,) * 3, "HEIGHT_ERRORS": (NOTHING,) * 3}),
    Variant("no unseen force", {"FORCES": (NOTHING,)}),
    Variant("no wandering load", {"LOADS": (NOTHING,)}),
    Variant("no outliers", {"OUTLIER": 1e3}),
    Variant("noise not scaled", {"SCALE_RANGE": (1.0, 1.0)}),
    Variant("no offsets of a drive", drives=(State.ROLL_DRIVE, State.AUX_DRIVE)),
    Variant("a drive keeps no offset of the last", {"DRIVE_KEPT": 0.0}),
    Variant("braking as sure as driving", {"BRAKE_NOISE": 0.0}),
    Variant("no loss by turning", priors=(State.NO_LOAD,)),
    Variant("no loss by force squared", priors=(State.COPPER,)),
    Variant(
        "no heating and cooling", priors=(State.COLD, State.HOT, State.COLD_START, State.HOT_START)
    ),
    Variant("no start of heating", priors=(State.COLD_START, State.HOT_START)),
    Variant("no cold tyres", priors=(State.ROLL_START, State.ROLL_COLD)),
)


@dataclass(frozen=True, slots=True)
class Row:
    """One variant on one car: errors in percent (median and mean), coverage in percent."""

    variant: str
    car: str
    carried_net: tuple[float, float]
    carried_coverage: float
    stretch_gross: float
    stretch_coverage: float
    likelihood: float


def car_intervals(data: str, key: str) -> tuple[Vehicle, list[list[Interval]]]:
    """The vehicle and the measured intervals of each drive of a car."""
    car = load_car(data, key)
    drives = []
    for drive in car.drives:
        stream = SampleStream(StreamSettings(), car.vehicle.air_density, car.vehicle.motor_ratio)
        found = [e for r in drive.readings for e in stream.push(r) if isinstance(e, Interval)]
        drives.append([each for each in found if not math.isnan(each.energy)])
    return car.vehicle, [drive for drive in drives if drive]


def ablate(key: str, vehicle: Vehicle, drives: Sequence[Sequence[Interval]]) -> Iterator[Row]:
    """Every variant on one car."""
    for variant in VARIANTS:
        with _replaced(variant):
            yield _score(variant.name, key, vehicle, drives)


@contextmanager
def _replaced(variant: Variant) -> Iterator[None]:
    before = {name: getattr(car_filter, name) for name in variant.constants}
    priors, drives = dict(car_state.PRIORS), dict(car_state.DRIVE_STD)
    for name, value in variant.constants.items():
        setattr(car_filter, name, value)
    car_state.PRIORS.update(dict.fromkeys(variant.priors, (0.0, NOTHING)))
    car_state.DRIVE_STD.update(dict.fromkeys(variant.drives, NOTHING))
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(car_filter, name, value)
        car_state.PRIORS.update(priors)
        car_state.DRIVE_STD.update(drives)


def _score(name: str, key: str, vehicle: Vehicle, drives: Sequence[Sequence[Interval]]) -> Row:
    car, carried, stretches = CarFilter(vehicle), [], []
    for number, drive in enumerate(drives):
        car.begin_drive()
        if number or len(drives) == 1:
            carried.append(_hidden(car, drive))
        stretches += list(_learn(car, drive))
    whole, parts = np.array(carried), np.array(stretches or [(1.0, 1.0, 1.0, 1.0)])
    net = 100.0 * np.abs(whole[:, 1] - whole[:, 0]) / np.abs(whole[:, 0])
    gross = 100.0 * np.abs(parts[:, 1] - parts[:, 0]) / parts[:, 3]
    return Row(
        name,
        key,
        (float(np.median(net)), float(np.mean(net))),
        _coverage(whole),
        float(np.median(gross)),
        _coverage(parts),
        _likelihood(whole) + _likelihood(parts),
    )


def _learn(
    car: CarFilter, drive: Sequence[Interval]
) -> Iterator[tuple[float, float, float, float]]:
    """Learn from a drive; of each stretch true, predicted energy, its sigma, gross energy, J."""
    ends = np.cumsum([interval.duration for interval in drive])
    next_cut = FIRST
    for index, interval in enumerate(drive):
        car.learn(interval)
        if ends[index] >= next_cut and ends[-1] - ends[index] > STRETCH:
            next_cut = ends[index] + STEP
            last = int(np.searchsorted(ends, ends[index] + STRETCH))
            yield _hidden(car, drive[index + 1 : last + 1])


def _hidden(car: CarFilter, intervals: Sequence[Interval]) -> tuple[float, float, float, float]:
    """True and predicted energy of intervals whose battery is hidden, its sigma, gross energy."""
    other = car.copy()
    other.state = replace_states(other.state, {State.ENERGY: 0.0})
    for interval in intervals:
        other.learn(replace(interval, energy=math.nan))
    energies = [interval.energy for interval in intervals]
    return (sum(energies), *other.unmeasured(), max(sum(map(abs, energies)), 1.0))


def _coverage(rows: np.ndarray) -> float:
    away = np.abs(rows[:, 1] - rows[:, 0]) / rows[:, 2]
    return 100.0 * float(np.mean(away <= GAUSSIAN_QUANTILE))


def _likelihood(rows: np.ndarray) -> float:
    away = np.minimum(np.abs(rows[:, 1] - rows[:, 0]) / rows[:, 2], MOST_SIGMAS)
    return float(np.mean(-0.5 * away**2 - np.log(rows[:, 2] / rows[:, 3])))
