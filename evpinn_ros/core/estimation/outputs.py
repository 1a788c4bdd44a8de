"""What the estimator says of a block of readings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from operator import itemgetter
from typing import NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.core.estimation.breakdown import Breakdown
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.estimate import ParameterSet, PowerEstimate, PowerKind
from evpinn_ros.core.estimation.learner import LearnerReport

Output: TypeAlias = PowerEstimate | ParameterSet


class PowerRows(NamedTuple):
    """`PowerEstimate` of n moments as columns of shape (n,), with their places in the block."""

    order: np.ndarray
    stamp_ns: np.ndarray
    power: np.ndarray
    sigma: np.ndarray
    energy: np.ndarray
    energy_sigma: np.ndarray

    def times(self, size: float) -> PowerRows:
        """Those of a car of another size (`estimation.size`)."""
        if size == 1.0:
            return self
        return PowerRows._make((*self[:2], *(size * column for column in self[2:])))


NO_POWERS = PowerRows(np.empty(0, np.int64), np.empty(0, np.int64), *np.empty((4, 0)))


class Learned(NamedTuple):
    """The parameters after a second of stamps, and what else is known of the car then.

    Attributes:
        place: in the block of the reading that ended the second.
        parameters: of the car.
        report: changes of payload and suspicions.
        model: the car as forecasts take it; None in the paper's mode.
        breakdown: energy of this drive, None where it was not asked for.
    """

    place: int
    parameters: ParameterSet
    report: LearnerReport
    model: CarModel | None
    breakdown: Breakdown | None


class Outputs(NamedTuple):
    """What an estimator says of a block.

    Attributes:
        measured: power that the battery readings measure.
        predicted: at the newest moments, by causal acceleration.
        smoothed: at the moments `smoothing_lag` back.
        learned: once a second.
    """

    measured: PowerRows = NO_POWERS
    predicted: PowerRows = NO_POWERS
    smoothed: PowerRows = NO_POWERS
    learned: Sequence[Learned] = ()

    def powers(self) -> Iterator[tuple[PowerKind, PowerRows]]:
        """The powers by their kind, in the order in which those of one reading come."""
        for kind in PowerKind:
            yield kind, getattr(self, kind.value)

    def by_place(self) -> list[tuple[int, Output]]:
        """Each output with the place in the block of the reading that completed it, in order."""
        rows: list[tuple[int, Output]] = []
        for kind, columns in self.powers():
            lists = [column.tolist() for column in columns]
            rows += [(row[0], PowerEstimate(kind, *row[1:])) for row in zip(*lists, strict=True)]
        rows += [(learned.place, learned.parameters) for learned in self.learned]
        return sorted(rows, key=itemgetter(0))


def joined_outputs(parts: Sequence[tuple[int, Outputs]]) -> Outputs:
    """Outputs of parts of a block, with the places at which these begin."""
    if not parts:
        return Outputs()
    if len(parts) == 1 and parts[0][0] == 0:
        return parts[0][1]
    kinds = []
    for kind in PowerKind:
        moved = []
        for begin, part in parts:
            rows: PowerRows = getattr(part, kind.value)
            moved.append(rows._replace(order=rows.order + begin))
        kinds.append(PowerRows._make(map(np.concatenate, zip(*moved, strict=True))))
    learned = [
        after._replace(place=after.place + begin)
        for begin, part in parts
        for after in part.learned
    ]
    return Outputs(kinds[0], kinds[1], kinds[2], learned)
