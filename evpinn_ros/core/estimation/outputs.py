"""Outputs of the estimator for a block of readings."""

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
    """`PowerEstimate` of n moments in order, as columns of shape (n,).

    Attributes:
        known_ns: stamp of the reading that completed each.
        stamp_ns: their moments.
        power: W.
        sigma: its 1-sigma, W.
        energy: predicted since the battery was last measured, J; if NaN, the meter integrates
            `power`.
        energy_sigma: its 1-sigma, J; if NaN, the meter integrates `sigma`.
    """

    known_ns: np.ndarray
    stamp_ns: np.ndarray
    power: np.ndarray
    sigma: np.ndarray
    energy: np.ndarray
    energy_sigma: np.ndarray

    @classmethod
    def of(
        cls, known_ns: np.ndarray, stamp_ns: np.ndarray, power: np.ndarray, sigma: np.ndarray
    ) -> PowerRows:
        """Powers, with NaN as energies."""
        unknown = np.full(len(power), np.nan)
        return cls(known_ns, stamp_ns, power, sigma, unknown, unknown)

    def times(self, size: float) -> PowerRows:
        """The powers scaled to a vehicle of another size (`estimation.size`)."""
        if size == 1.0:
            return self
        return PowerRows._make((*self[:2], *(size * column for column in self[2:])))


NO_POWERS = PowerRows(np.empty(0, np.int64), np.empty(0, np.int64), *np.empty((4, 0)))


class Learned(NamedTuple):
    """The parameters after a second of stamps, and the other estimates then.

    Attributes:
        known_ns: stamp of the speed that ended the second.
        parameters: of the car.
        report: changes of payload and suspicions.
        model: the car for forecasts; None in `mode: paper`.
        breakdown: of the energy of this drive, None if it was not asked for.
    """

    known_ns: int
    parameters: ParameterSet
    report: LearnerReport
    model: CarModel | None
    breakdown: Breakdown | None


class Outputs(NamedTuple):
    """Outputs of an estimator for a block.

    Attributes:
        measured: power of the battery readings, in order of arrival.
        predicted: at the newest speeds, by causal acceleration.
        smoothed: at the smoothed samples, `smoothing_lag` back.
        learned: once a second.
    """

    measured: PowerRows = NO_POWERS
    predicted: PowerRows = NO_POWERS
    smoothed: PowerRows = NO_POWERS
    learned: Sequence[Learned] = ()

    def powers(self) -> Iterator[tuple[PowerKind, PowerRows]]:
        """The powers by their kind."""
        for kind in PowerKind:
            yield kind, getattr(self, kind.value)

    def in_order(self) -> list[tuple[int, Output]]:
        """Each output with the stamp of the reading that completed it, in order of these."""
        rows: list[tuple[int, Output]] = []
        for kind, columns in self.powers():
            if not len(columns.power):
                continue
            lists = [column.tolist() for column in columns]
            rows += [(row[0], PowerEstimate(kind, *row[1:])) for row in zip(*lists, strict=True)]
        rows += [(learned.known_ns, learned.parameters) for learned in self.learned]
        return sorted(rows, key=itemgetter(0))


def joined_outputs(parts: Sequence[Outputs]) -> Outputs:
    """Concatenated outputs of consecutive parts of a block."""
    if len(parts) < 2:
        return parts[0] if parts else Outputs()
    measured, predicted, smoothed = (
        PowerRows._make(map(np.concatenate, zip(*rows, strict=True)))
        for rows in zip(*(part[:3] for part in parts), strict=True)
    )
    learned = [after for part in parts for after in part.learned]
    return Outputs(measured, predicted, smoothed, learned)
