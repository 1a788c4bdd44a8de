"""The core with some of its constants replaced, and what it says without the battery.

Drives of a car become intervals once. A variant of the core then predicts every drive from what
the ones before taught, and 200 s stretches within the drives, battery hidden; both are scored by
error, coverage of the 90 % interval and likelihood (of the error over the gross energy, heavy
tails cut off at 4 sigmas).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
import math
from typing import Any, NamedTuple

import numpy as np

from benchmarks.unseen.drives import load_car
from evpinn_ros.estimation import car_filter, car_state, interval_noise
from evpinn_ros.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.estimation.car_filter import CarFilter
from evpinn_ros.estimation.car_state import State
from evpinn_ros.estimation.gaussian import replace_states
from evpinn_ros.estimation.learner import gate_interval
from evpinn_ros.signals.interval import Interval
from evpinn_ros.signals.stream import SampleStream, StreamSettings
from evpinn_ros.vehicle.files import Vehicle

STRETCH, STEP, FIRST = 195.0, 200.0, 250.0  # s: hidden, between two, before the first
MOST_SIGMAS = 4.0

# What `car_filter` imports from `car_state` by its name is replaced where it is used.
TABLES: Mapping[str, MutableMapping[Any, Any]] = {
    "car_filter": vars(car_filter),
    "interval_noise": vars(interval_noise),
    "PRIORS": car_state.PRIORS,
    "DRIVE_STD": car_state.DRIVE_STD,
}


class ConstantPlace(NamedTuple):
    """Place of a constant: a table of `TABLES` and its key there."""

    table: str
    key: str | State

    @property
    def name(self) -> str:
        """As the code has it."""
        return self.key.name if isinstance(self.key, State) else self.key

    @property
    def present(self) -> Any:
        """The constant's value."""
        return TABLES[self.table][self.key]


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
    by_drive: tuple[float, ...] = ()

    def gain(self, over: VariantRow) -> tuple[float, float]:
        """Likelihood more than another variant has on the same car, and its standard error."""
        more = np.subtract(self.by_drive, over.by_drive)
        error = float(np.std(more, ddof=1)) / math.sqrt(len(more)) if len(more) > 1 else math.nan
        return float(np.mean(more)), error


# As `cli.output.table_of` takes them.
SCORE_COLUMNS = (
    ("carried: net %", "{0.carried_net[0]:.1f}; {0.carried_net[1]:.1f}"),
    ("in 90 %", "{0.carried_coverage:.0f}"),
    ("200 s: gross %", "{0.stretch_gross:.1f}"),
    ("in 90 %", "{0.stretch_coverage:.0f}"),
    ("likelihood", "{0.likelihood:.2f}"),
)


def constant(name: str) -> ConstantPlace:
    """A constant of the filter or of the noise of its intervals."""
    own = name in vars(interval_noise)
    return ConstantPlace("interval_noise" if own else "car_filter", name)


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
    """Score a variant on a car's drives."""
    with replaced(variant.changes):
        return _score(variant.name, car)


def _replace(changes: Mapping[ConstantPlace, Any]) -> None:
    for place, value in changes.items():
        TABLES[place.table][place.key] = value


def _score(name: str, recorded: RecordedCar) -> VariantRow:
    car, carried, stretches, by_drive = CarFilter(recorded.vehicle), [], [], []
    for number, drive in enumerate(recorded.drives):
        car.begin_drive()
        whole = [_hidden(car, drive)] if number or len(recorded.drives) == 1 else []
        parts = list(_learn(car, drive))
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
        tuple(by_drive),
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
