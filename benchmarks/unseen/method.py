"""The interface of a method that is scored, and our own estimator behind it.

A method is made by `factory(vehicle)` and gets every reading of a car in recorded order. It must
be possible to copy it with `copy.deepcopy`: the copy then goes on without battery readings, and
the original goes on with them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
import math
from typing import NamedTuple, Protocol, TypeAlias

from evpinn_ros.core.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.replays.chain import Chain

Estimate: TypeAlias = tuple[float, float]  # value and 1-sigma
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
    """Method that is scored."""

    def add_reading(self, reading: Reading) -> Iterable[Prediction] | None:
        """Take one reading; give the predictions it completes, in order of time; None if none."""

    def begin_next_drive(self) -> None:
        """Begin another drive of the same car."""

    def combinations(self) -> Mapping[str, Estimate]:
        """Estimates of the car, by `NAMES`; empty if there are none."""


Factory: TypeAlias = Callable[[Vehicle], Method]


class OnlineChain:
    """Our estimator and energy account, as `evpinn replay` runs them."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._chain = Chain(vehicle, EstimatorSettings(), InlineWorker(lambda: 0.0))
        self._voltage_ns = self._current_ns = 0

    def add_reading(self, reading: Reading) -> Iterable[Prediction]:
        """The `power/smoothed` that the reading completes, with the energy since the battery."""
        if isinstance(reading, BatteryReading):
            if not math.isnan(reading.voltage):
                self._voltage_ns = reading.stamp_ns
            if not math.isnan(reading.current):
                self._current_ns = reading.stamp_ns
        known_ns = min(self._voltage_ns, self._current_ns)
        for output in self._chain.add_reading(reading):
            if isinstance(output, PowerEstimate) and output.kind is PowerKind.SMOOTHED:
                age = (output.stamp_ns - known_ns) / NANOSECONDS
                energy = output.energy, output.energy_sigma
                if known_ns and (age <= 0.0 or math.isnan(output.energy)):  # no dropout yet
                    energy = output.power * age, 0.0
                yield Prediction(output.stamp_ns, output.power, output.sigma, *energy)

    def begin_next_drive(self) -> None:
        """Keep what was learned of the car."""
        self._chain.begin_next_drive()
        self._voltage_ns = self._current_ns = 0

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
