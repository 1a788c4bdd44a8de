"""Scores variants of the core, with some of its constants replaced, while the battery is hidden.

Drives of a car become intervals once. A variant of the core then predicts every drive from what
the ones before taught, and 200 s stretches within the drives, battery hidden. Both are scored by
CRPS, coverage of the 90 % interval and likelihood (of the error over the gross energy, heavy
tails cut off at 4 sigmas), the stretches also by the error of power. All are means over seeds of
the network.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from importlib import import_module
import math
from typing import Any, NamedTuple

import numpy as np

from benchmarks.unseen.drives import load_car
from benchmarks.unseen.scores import MOST_SIGMAS, QUANTILE_90, crps
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.journey import NOWHERE
from evpinn_ros.core.estimation.learner import gate_interval
from evpinn_ros.core.estimation.posterior import interval_terms
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.terms import Equation
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.vehicle.files import Vehicle

STRETCH, STEP, FIRST = 195.0, 200.0, 250.0  # s: a hidden stretch, between two, before the first
SEEDS = (0, 1, 2)  # of the network, over which scores are averaged


class ConstantPlace(NamedTuple):
    """Place of a constant: a module of `core.estimation` or a state, and its name there.

    What a module imports from another by its name is replaced where it is used.
    """

    owner: str | State
    key: str

    @property
    def name(self) -> str:
        """Name of the constant in tables."""
        return f"{self.owner.name}.{self.key}" if isinstance(self.owner, State) else self.key

    @property
    def present(self) -> Any:
        """The constant's value."""
        return getattr(self._holder, self.key)

    def put(self, value: Any) -> None:
        """Replace the value, in this process."""
        if not hasattr(self._holder, self.key):
            raise AttributeError(f"{self.owner} has no {self.key}")
        setattr(self._holder, self.key, value)

    @property
    def _holder(self) -> Any:
        if isinstance(self.owner, State):
            return self.owner
        return import_module(f"evpinn_ros.core.estimation.{self.owner}")


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
    """One variant on one car, means over seeds: CRPS in percent of gross energy.

    `stretch_rmse` is of power over intervals, W. `by_drive` is the likelihood of each drive,
    carried and of its stretches, from which `gain` computes the standard error of a difference.
    """

    variant: str
    car: str
    carried_crps: float
    carried_coverage: float
    stretch_crps: float
    stretch_coverage: float
    stretch_rmse: float
    likelihood: float
    by_drive: tuple[float, ...] = ()

    def gain(self, over: VariantRow) -> tuple[float, float]:
        """Likelihood more than another variant has on the same car, and its standard error."""
        more = np.subtract(self.by_drive, over.by_drive)
        error = float(np.std(more, ddof=1)) / math.sqrt(len(more)) if len(more) > 1 else math.nan
        return float(np.mean(more)), error


# As `cli.output.table_of` takes them.
SCORE_COLUMNS = (
    ("carried: CRPS %", "{0.carried_crps:.2f}"),
    ("in 90 %", "{0.carried_coverage:.0f}"),
    ("200 s: CRPS %", "{0.stretch_crps:.2f}"),
    ("in 90 %", "{0.stretch_coverage:.0f}"),
    ("RMSE W", "{0.stretch_rmse:.0f}"),
    ("likelihood", "{0.likelihood:.2f}"),
)


def read_car(data: str, key: str) -> RecordedCar:
    """Read or simulate a car of `evpinn bench unseen`.

    Raises:
        InputError: none of its drives can be read.
    """
    car = load_car(data, key)
    drives = []
    for drive in car.drives:
        intervals = drive.intervals(car.vehicle)
        drives.append(
            [e for e in intervals if not math.isnan(e.energy) and gate_interval(e) is None]
        )
    return RecordedCar(key, car.vehicle, [drive for drive in drives if drive])


@contextmanager
def replaced(changes: Mapping[ConstantPlace, Any]) -> Iterator[None]:
    """Replace constants of the core in this process within a block."""
    before = {place: place.present for place in changes}
    _replace(changes)
    try:
        yield
    finally:
        _replace(before)


def score(variant: Variant, car: RecordedCar, seeds: Sequence[int] = SEEDS) -> VariantRow:
    """Score a variant on a car's drives."""
    with replaced(variant.changes):
        rows = [_score(variant.name, car, seed) for seed in seeds]
    scores = [field.name for field in fields(VariantRow)[2:-1]]
    means: dict[str, Any] = {
        name: float(np.mean([getattr(row, name) for row in rows])) for name in scores
    }
    by_drive = np.mean([row.by_drive for row in rows], axis=0).tolist()
    return replace(rows[0], **means, by_drive=tuple(by_drive))


def _replace(changes: Mapping[ConstantPlace, Any]) -> None:
    for place, value in changes.items():
        place.put(value)


class _Hidden(NamedTuple):
    """Intervals whose battery was hidden: J, but for the squared errors of power, W^2."""

    true: float
    predicted: float
    sigma: float
    gross: float
    squares: float  # mean over the intervals


def _score(name: str, recorded: RecordedCar, seed: int) -> VariantRow:
    car = LearnedCar.new(Equation(recorded.vehicle, seed))
    carried: list[_Hidden] = []
    stretches: list[_Hidden] = []
    by_drive = []
    for number, drive in enumerate(recorded.drives):
        car = car.begin_drive()
        whole = [_hidden(car, drive)] if number or len(recorded.drives) == 1 else []
        car, parts = _learn(car, drive)
        by_drive.append(sum(_likelihood(np.array(rows)) for rows in (whole, parts) if rows))
        carried += whole
        stretches += parts
    drives, cuts = np.array(carried), np.array(stretches or [_Hidden(1.0, 1.0, 1.0, 1.0, 0.0)])
    return VariantRow(
        variant=name,
        car=recorded.key,
        carried_crps=_crps(drives),
        carried_coverage=_coverage(drives),
        stretch_crps=_crps(cuts),
        stretch_coverage=_coverage(cuts),
        stretch_rmse=math.sqrt(float(np.mean(cuts[:, 4]))),
        likelihood=_likelihood(drives) + _likelihood(cuts),
        by_drive=tuple(by_drive),
    )


def _learn(car: LearnedCar, drive: Sequence[Interval]) -> tuple[LearnedCar, list[_Hidden]]:
    """The car after a drive, and its prediction of each stretch."""
    ends = np.cumsum([interval.duration for interval in drive])
    next_cut, rows = FIRST, []
    for index, interval in enumerate(drive):
        car = car.after([interval])
        if ends[index] >= next_cut and ends[-1] - ends[index] > STRETCH:
            next_cut = ends[index] + STEP
            last = int(np.searchsorted(ends, ends[index] + STRETCH))
            rows.append(_hidden(car, drive[index + 1 : last + 1]))
    return car, rows


def _hidden(car: LearnedCar, intervals: Sequence[Interval]) -> _Hidden:
    """Predict intervals whose battery is hidden."""
    model, journey, along = car.state.model(car.equation), NOWHERE, [0.0]
    for interval in intervals:
        seconds = car.state.seconds + journey.seconds
        journey = journey.plus(interval_terms(car.equation, interval, seconds).journey)
        along.append(model.energy(journey).mean)
    energies = np.array([interval.energy for interval in intervals])
    errors = (np.diff(along) - energies) / [interval.duration for interval in intervals]
    gross = max(float(np.abs(energies).sum()), 1.0)
    return _Hidden(
        float(energies.sum()), *model.predicted(journey), gross, float(np.mean(errors**2))
    )


def _crps(rows: np.ndarray) -> float:
    scores = [
        crps(energy - true, sigma) / gross for true, energy, sigma, gross, _ in rows.tolist()
    ]
    return 100.0 * float(np.mean(scores))


def _coverage(rows: np.ndarray) -> float:
    away = np.abs(rows[:, 1] - rows[:, 0]) / rows[:, 2]
    return 100.0 * float(np.mean(away <= QUANTILE_90))


def _likelihood(rows: np.ndarray) -> float:
    away = np.minimum(np.abs(rows[:, 1] - rows[:, 0]) / rows[:, 2], MOST_SIGMAS)
    return float(np.mean(-0.5 * away**2 - np.log(rows[:, 2] / rows[:, 3])))
