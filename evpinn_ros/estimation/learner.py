"""What the two modes have in common: the interface the online estimator drives."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
import math
from typing import Any, NamedTuple, Protocol

from evpinn_ros.estimation.estimate import ParameterSet
from evpinn_ros.estimation.load_change import LoadChange
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.linear_power import LinearPower
from evpinn_ros.vehicle.physics import STANDSTILL_SPEED

REVERSE_SPEED = -0.1  # m/s: below this the car reverses
CHARGING_POWER = -500.0  # W at standstill: below this the battery is being charged
STATE_VERSION = 4


class PowerPrediction(NamedTuple):
    """Battery power, W, and the model's own 1-sigma, W, not yet calibrated."""

    power: float
    sigma: float


class LearnerReport(NamedTuple):
    """What a learner noticed of the car and its signals.

    Attributes:
        load_change: the last change of payload, None when none was found.
        load_changes: changes found.
        load_changes_withdrawn: of them, changes that later data took back.
        suspicion: name of a fault of the signals that the data speak for, or None.
        lag: by how much power follows speed, s, NaN where that is not estimated.
        lag_std: its 1-sigma, s.
    """

    load_change: LoadChange | None = None
    load_changes: int = 0
    load_changes_withdrawn: int = 0
    suspicion: str | None = None
    lag: float = math.nan
    lag_std: float = math.nan


class Learner(Protocol):
    """A mode of learning. Time enters only through the samples' stamps."""

    gated: Counter[str]

    def advance(self, sample: Sample) -> None:
        """Let time pass up to a smoothed sample."""

    def predict(self, sample: Sample) -> PowerPrediction:
        """Power at a sample from what was learned from earlier samples and speed alone."""

    def observe(self, sample: Sample, power: float) -> None:
        """Learn from a sample whose battery power, W, was measured."""

    def prepare_update(self) -> Callable[[], Any] | None:
        """Work of one windowed update on a snapshot, safe to run in another thread, or None."""

    def consider(self, candidate: Any) -> str | None:
        """Adopt the result of an update, or return the reason why not."""

    def parameters(self) -> ParameterSet:
        """Present estimate of the parameters."""

    def linear_power(self, celsius: float | None) -> LinearPower | None:
        """What forecasts of plans need of the car at an ambient temperature, None where unknown.

        None when it is no linear model.
        """

    def report(self) -> LearnerReport:
        """What was noticed of the car and its signals."""

    def forget_window(self) -> None:
        """Drop recent samples after a jump of time; keep what was learned."""

    def end_drive(self) -> None:
        """Let what comes be another drive, wherever its stamps lie."""

    def export(self) -> Mapping[str, Any]:
        """State to save, of numbers, text, lists and mappings only."""

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take a state given by `export`; ValueError or KeyError when it does not fit."""


def gate(sample: Sample, power: float) -> str | None:
    """Why a sample may not be learned from, or None."""
    if sample.speed < REVERSE_SPEED:
        return "reverse"
    if abs(sample.speed) < STANDSTILL_SPEED and power < CHARGING_POWER:
        return "charging"
    return None
