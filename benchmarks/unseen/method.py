"""The interface of a method that is scored, and our own estimator behind it.

A method is made by `factory(vehicle)` and gets every reading of a car in recorded order.
`copy.deepcopy` must work on it: the copy continues without battery readings, the original with
them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
import math
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np

from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.outputs import Outputs
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading
from evpinn_ros.core.signals.time_jump import Jump
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.replays.chain import Chain

Estimate: TypeAlias = tuple[float, float]  # value and 1-sigma
KEPT = 100  # stamps of the battery
AT_ONCE = 20_000  # readings
NAMES = ("mass_over_eta", "regeneration", "rolling_over_eta", "drag_area_over_eta", "p_aux")


class Prediction(NamedTuple):
    """Prediction of one moment, from readings before it and at most a little after."""

    stamp_ns: int  # the moment
    power: float  # battery power, W, positive when drawn
    sigma: float = math.nan  # its 1-sigma, W, NaN if unknown
    # integral of the predicted power since the last battery reading or any other moment before,
    # J; NaN: take the trapezoid of `power`
    energy: float = math.nan
    # 1-sigma, J, of the energy predicted since the last battery reading
    energy_sigma: float = math.nan


class Method(Protocol):
    """A method that is scored.

    Optional: `add_readings(readings)` takes several readings and returns their predictions;
    `finish()` returns the remaining predictions of a drive; with `pairs = True` the method joins
    voltage and current of different stamps itself, otherwise each battery reading has both.
    """

    def add_reading(self, reading: Reading) -> Iterable[Prediction] | None:
        """Take one reading; returns the predictions it completes, in order of time, or None."""

    def begin_next_drive(self) -> None:
        """Begin another drive of the same car."""

    def combinations(self) -> Mapping[str, Estimate]:
        """Estimates of the car, by `NAMES`; empty if there are none."""


Factory: TypeAlias = Callable[[Vehicle], Method]


class OnlineChain:
    """Our estimator and energy account, as `evpinn replay` runs them."""

    pairs = True

    def __init__(self, vehicle: Vehicle) -> None:
        self._chain = Chain(vehicle, EstimatorSettings(), InlineWorker(lambda: 0.0))
        self._told_ns = [np.zeros(1, np.int64)] * 2  # voltage, current

    def add_reading(self, reading: Reading) -> Iterable[Prediction]:
        """The `power/smoothed` that the reading completes, with the energy since the battery."""
        return self.add_readings([reading])

    def add_readings(self, readings: Sequence[Reading]) -> Iterator[Prediction]:
        """The same of several readings."""
        whole = Block.of(readings).parts(AT_ONCE)
        for block in (item for part in whole for item in self._chain.follow(part)):
            if isinstance(block, Jump):
                self._chain.jump()
                continue
            self._hear(block)
            outputs = self._chain.read(block)
            self._chain.account.count()
            yield from self._predictions(outputs)

    def finish(self) -> Iterator[Prediction]:
        """The remaining predictions of a drive."""
        return self._predictions(self._chain.read_rest())

    def _predictions(self, outputs: Outputs) -> Iterator[Prediction]:
        by_ns, stamps, power, sigma, energy, energy_sigma = outputs.smoothed
        known_ns = self._known(by_ns)
        age = (stamps - known_ns) / NANOSECONDS
        no_dropout = (known_ns > 0) & ((age <= 0.0) | np.isnan(energy))
        energy = np.where(no_dropout, power * age, energy)
        energy_sigma = np.where(no_dropout, 0.0, energy_sigma)
        columns = stamps, power, sigma, energy, energy_sigma
        yield from map(Prediction, *(column.tolist() for column in columns))

    def _hear(self, block: Block) -> None:
        """Record the stamps of voltage and current."""
        rows = block.of_kind(BatteryReading)
        for index, values in enumerate(rows.values[:2]):
            stamps = np.append(self._told_ns[index][-KEPT:], rows.stamps[~np.isnan(values)])
            self._told_ns[index] = np.sort(stamps)

    def _known(self, by_ns: np.ndarray) -> np.ndarray:
        """Newest stamps up to `by_ns` at which voltage and current were measured, ns, (n,)."""
        known = (
            stamps[np.maximum(stamps.searchsorted(by_ns, side="right") - 1, 0)]
            for stamps in self._told_ns
        )
        return np.asarray(np.minimum(*known))

    def begin_next_drive(self) -> None:
        """Keep what was learned of the car."""
        self._chain.begin_next_drive()
        self._told_ns = [np.zeros(1, np.int64)] * 2

    def combinations(self) -> Mapping[str, Estimate]:
        """The published combinations.

        C_rr m/eta is the product of two of them, whose errors are taken as independent.
        """
        estimates = self._chain.estimator.parameters()
        value, std = estimates.identifiable, estimates.identifiable_std
        rolling = value.c_rr * value.mass_over_eta
        share = math.hypot(std.c_rr / value.c_rr, std.mass_over_eta / value.mass_over_eta)
        p_aux = estimates.parameters["p_aux"]
        return {
            "mass_over_eta": (value.mass_over_eta, std.mass_over_eta),
            "regeneration": (value.regeneration, std.regeneration),
            "rolling_over_eta": (rolling, rolling * share),
            "drag_area_over_eta": (value.drag_area_over_eta, std.drag_area_over_eta),
            "p_aux": (p_aux.value, p_aux.std),
        }
