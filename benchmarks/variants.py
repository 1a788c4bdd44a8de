"""The core with some of its constants replaced, and what it says without the battery.

Drives of a car become intervals once. A variant of the core then predicts every drive from what
the ones before taught, and 200 s stretches within the drives, battery hidden; both are scored by
error, CRPS, coverage of the 90 % interval and likelihood (of the error over the gross energy,
heavy tails cut off at 4 sigmas). Each variant runs with several seeds of the network.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
import math
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from benchmarks.unseen.drives import load_car
from benchmarks.unseen.scores import crps
from evpinn_ros.estimation import bands, learning, posterior
from evpinn_ros.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.estimation.car import LearnedCar
from evpinn_ros.estimation.learner import gate_interval
from evpinn_ros.estimation.states import State
from evpinn_ros.estimation.terms import Equation
from evpinn_ros.signals.interval import Interval
from evpinn_ros.signals.stream import SampleStream, StreamSettings
from evpinn_ros.vehicle.files import Vehicle

STRETCH, STEP, FIRST = 195.0, 200.0, 250.0  # s: hidden, between two, before the first
MOST_SIGMAS = 4.0
SEEDS = 2
HOLDERS: Mapping[str, Any] = {"posterior": posterior, "bands": bands, "learning": learning}


class ConstantPlace(NamedTuple):
    """Place of a constant: one of `HOLDERS` or the name of a state, and its name there."""

    holder: str
    key: str

    @property
    def name(self) -> str:
        """As the code has it."""
        return self.key if self.holder in HOLDERS else f"{self.holder} {self.key}"

    @property
    def present(self) -> Any:
        """The constant's value."""
        return getattr(_holder(self.holder), self.key)


@dataclass(frozen=True, slots=True)
class Variant:
    """The core with these constants in place of its own."""

    name: str
    changes: Mapping[ConstantPlace, Any] = field(default_factory=dict)


class RecordedCar(NamedTuple):
    """A car and the measured intervals of each of its drives, in order."""

    key: str
    vehicle: Vehicle
    drives: list[list[Interval]]


@dataclass(frozen=True, slots=True)
class VariantRow:
    """One variant on one car: errors in percent (median and mean), coverage in percent.

    `by_drive` is the likelihood of each drive, carried and of its stretches: what is left of a
    difference of variants once they are compared drive by drive tells how sure it is.
    """

    variant: str
    car: str
    carried_net: tuple[float, float]
    carried_coverage: float
    stretch_gross: float
    stretch_coverage: float
    likelihood: float
    carried_crps: float = math.nan
    stretch_crps: float = math.nan
    by_drive: tuple[float, ...] = ()

    def gain(self, over: VariantRow) -> tuple[float, float]:
        """Likelihood more than another variant has on the same car, and its standard error."""
        more = np.subtract(self.by_drive, over.by_drive)
        error = float(np.std(more, ddof=1)) / math.sqrt(len(more)) if len(more) > 1 else math.nan
        return float(np.mean(more)), error


# As `cli.output.table_of` takes them.
SCORE_COLUMNS = (
    ("carried: net %", "{0.carried_net[0]:.1f}; {0.carried_net[1]:.1f}"),
    ("CRPS %", "{0.carried_crps:.2f}"),
    ("in 90 %", "{0.carried_coverage:.0f}"),
    ("200 s: gross %", "{0.stretch_gross:.1f}"),
    ("CRPS %", "{0.stretch_crps:.2f}"),
    ("in 90 %", "{0.stretch_coverage:.0f}"),
    ("likelihood", "{0.likelihood:.2f}"),
)


def constant(name: str) -> ConstantPlace:
    """A constant of one of the modules in `HOLDERS`."""
    return ConstantPlace(
        next(key for key, module in HOLDERS.items() if name in vars(module)), name
    )


def prior(state: State, key: str) -> ConstantPlace:
    """The `mean` or `std` of a state before any drive."""
    return ConstantPlace(state.name, key)


def read_car(data: str, key: str) -> RecordedCar:
    """Read or simulate a car of `evpinn bench unseen`.

    Raises:
        InputError: none of its drives can be read.
    """
    car = load_car(data, key)
    drives = []
    for drive in car.drives:
        stream = SampleStream(StreamSettings(), car.vehicle.air_density, car.vehicle.motor_ratio)
        found = [
            e for r in drive.readings for e in stream.add_reading(r) if isinstance(e, Interval)
        ]
        drives.append([e for e in found if not math.isnan(e.energy) and gate_interval(e) is None])
    return RecordedCar(key, car.vehicle, [drive for drive in drives if drive])


@contextmanager
def replaced(changes: Mapping[ConstantPlace, Any]) -> Iterator[None]:
    """The core with other constants, in this process, as long as the context lasts."""
    before = {place: place.present for place in changes}
    _replace(changes)
    try:
        yield
    finally:
        _replace(before)


def score(variant: Variant, car: RecordedCar) -> VariantRow:
    """Score a variant on a car's drives, seeds averaged."""
    with replaced(variant.changes):
        return _mean([_score(variant.name, car, seed) for seed in range(SEEDS)])


def _holder(name: str) -> Any:
    return HOLDERS.get(name) or State[name]


def _replace(changes: Mapping[ConstantPlace, Any]) -> None:
    for place, value in changes.items():
        setattr(_holder(place.holder), place.key, value)


def _mean(rows: Sequence[VariantRow]) -> VariantRow:
    """Mean of rows that differ by their seed."""
    net, by_drive = (
        np.mean([getattr(row, name) for row in rows], axis=0)
        for name in ("carried_net", "by_drive")
    )
    return replace(
        rows[0],
        carried_net=(float(net[0]), float(net[1])),
        carried_coverage=fmean(row.carried_coverage for row in rows),
        stretch_gross=fmean(row.stretch_gross for row in rows),
        stretch_coverage=fmean(row.stretch_coverage for row in rows),
        likelihood=fmean(row.likelihood for row in rows),
        carried_crps=fmean(row.carried_crps for row in rows),
        stretch_crps=fmean(row.stretch_crps for row in rows),
        by_drive=tuple(by_drive.tolist()),
    )


def _score(name: str, recorded: RecordedCar, seed: int) -> VariantRow:
    # A new equation, for that of `equation_of` may hold priors of another variant.
    car = LearnedCar.new(Equation(recorded.vehicle, seed))
    carried, stretches, by_drive = [], [], []
    for number, drive in enumerate(recorded.drives):
        car = car.begin_drive()
        whole = [_hidden(car, drive)] if number or len(recorded.drives) == 1 else []
        car, parts = _learned(car, drive)
        by_drive.append(sum(_likelihood(np.array(rows)) for rows in (whole, parts) if rows))
        carried += whole
        stretches += parts
    drives, cuts = np.array(carried), np.array(stretches or [(1.0, 1.0, 1.0, 1.0)])
    net = 100.0 * np.abs(drives[:, 1] - drives[:, 0]) / np.abs(drives[:, 0])
    gross = 100.0 * np.abs(cuts[:, 1] - cuts[:, 0]) / cuts[:, 3]
    return VariantRow(
        name,
        recorded.key,
        (float(np.median(net)), float(np.mean(net))),
        _coverage(drives),
        float(np.median(gross)),
        _coverage(cuts),
        _likelihood(drives) + _likelihood(cuts),
        _crps(drives),
        _crps(cuts),
        tuple(by_drive),
    )


Hidden = tuple[float, float, float, float]
"""True and predicted energy of what was hidden, its sigma, and gross energy, J."""


def _learned(car: LearnedCar, drive: Sequence[Interval]) -> tuple[LearnedCar, list[Hidden]]:
    """The car after a drive, and the stretches of it that it predicted."""
    ends = np.cumsum([interval.duration for interval in drive])
    next_cut, found = FIRST, []
    for index, interval in enumerate(drive):
        car = car.after([interval])
        if ends[index] >= next_cut and ends[-1] - ends[index] > STRETCH:
            next_cut = ends[index] + STEP
            last = int(np.searchsorted(ends, ends[index] + STRETCH))
            found.append(_hidden(car, drive[index + 1 : last + 1]))
    return car, found


def _hidden(car: LearnedCar, intervals: Sequence[Interval]) -> Hidden:
    """What intervals took, and what they are predicted to take with the battery hidden."""
    other = car.after([replace(interval, energy=math.nan) for interval in intervals])
    predicted, sigma = other.state.model(other.equation).predicted(other.dropout)
    energies = [interval.energy for interval in intervals]
    return sum(energies), predicted, sigma, max(sum(map(abs, energies)), 1.0)


def _coverage(rows: np.ndarray) -> float:
    away = np.abs(rows[:, 1] - rows[:, 0]) / rows[:, 2]
    return 100.0 * float(np.mean(away <= GAUSSIAN_QUANTILE))


def _crps(rows: np.ndarray) -> float:
    """Mean CRPS, percent of gross energy."""
    return 100.0 * fmean(crps(found - true, s) / gross for true, found, s, gross in rows.tolist())


def _likelihood(rows: np.ndarray) -> float:
    away = np.minimum(np.abs(rows[:, 1] - rows[:, 0]) / rows[:, 2], MOST_SIGMAS)
    return float(np.mean(-0.5 * away**2 - np.log(rows[:, 2] / rows[:, 3])))
