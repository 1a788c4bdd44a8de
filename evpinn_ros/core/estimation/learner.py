"""Interface of the two modes, which the online estimator drives."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
import math
from typing import Any, NamedTuple, Protocol, TypeAlias

from evpinn_ros.core.estimation.breakdown import Breakdowns, EndedDrive
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.estimate import ParameterSet
from evpinn_ros.core.estimation.evidence import NO_EVIDENCE, Evidence
from evpinn_ros.core.estimation.payload import PayloadChange
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.sample import MeasuredSample, Sample
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED

REVERSE_SPEED = -0.1  # m/s: below this the car reverses
REVERSE_STEP = -0.1  # m, the same for a step of an interval
CHARGING_POWER = -500.0  # W at standstill: below this the battery is being charged
STATE_VERSION = 10


LearningEvent: TypeAlias = MeasuredSample | Interval


class PowerPrediction(NamedTuple):
    """Battery power, W, and the model's own 1-sigma, W, not yet calibrated.

    `energy`, J, is predicted since the battery was last measured, `energy_sigma` its 1-sigma, J;
    NaN where they are not known.
    """

    power: float
    sigma: float
    energy: float = math.nan
    energy_sigma: float = math.nan


class LearnerReport(NamedTuple):
    """Detections of a learner on the car and its signals.

    Attributes:
        payload_change: the last change of payload, None when none was found.
        payload_changes: changes found.
        payload_changes_withdrawn: of them, changes that later data took back.
        suspicion: name of a fault of the signals that the data suggest, or None.
    """

    payload_change: PayloadChange | None = None
    payload_changes: int = 0
    payload_changes_withdrawn: int = 0
    suspicion: str | None = None


class Learner(Protocol):
    """A mode of learning. Time enters only through the samples' stamps.

    What a mode need not do has a body here: who derives from this does none of it.
    """

    gated: Counter[str]
    learns: type[LearningEvent]
    """Events that its updates learn from."""

    def expect(self, samples: Sequence[Sample]) -> None:
        """Prepare to predict these samples, before an update or a jump of time comes."""
        return

    def advance(self, sample: Sample) -> None:
        """Let time pass up to a smoothed sample."""
        return

    def predict(self, sample: Sample) -> PowerPrediction:
        """Power at a sample from what was learned from earlier samples and speed alone."""

    def battery_measured(self, stamp_ns: int) -> None:
        """Note that the battery was measured then, whether or not that is learned from."""
        return

    def observe(self, sample: Sample, power: float) -> None:
        """Learn from a sample whose battery power, W, was measured."""

    def add_interval(self, interval: Interval) -> bool:
        """Take an interval, its battery measured or not; gives whether an update is due."""
        return False

    def prepare_update(self) -> Callable[[], Any] | None:
        """Work of one windowed update on a snapshot, safe to run in another thread, or None."""

    def consider(self, candidate: Any) -> str | None:
        """Accept the result of an update, or return the reason why not."""

    def parameters(self) -> ParameterSet:
        """Present estimate of the parameters."""

    def evidence(self) -> Evidence:
        """Likelihood of the parameters without their prior (see `estimation.evidence`)."""
        return NO_EVIDENCE

    def drive(self) -> tuple[EndedDrive, ...]:
        """Parts of this drive so far, to be kept for `together`; none where not known."""
        return ()

    def together(self, before: Sequence[EndedDrive]) -> Breakdowns | None:
        """Energy of this drive and of others before it, as that of one; None where not known."""
        return None

    def breakdowns(self) -> Breakdowns | None:
        """Energy of this drive, and of those kept before it, by where it went.

        None where that is not known.
        """
        return None

    def model(self) -> CarModel | None:
        """The car as forecasts take it; None in the paper's mode."""
        return None

    def report(self) -> LearnerReport:
        """Detections so far."""
        return LearnerReport()

    def forget_window(self) -> None:
        """Drop recent samples after a jump of time; keep what was learned."""

    def end_drive(self) -> None:
        """Let what comes be another drive, wherever its stamps lie."""
        return

    def saved(self) -> Any:
        """State to save (see `common.saved_fields`)."""

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from a saved state; ValueError when it is not possible."""


def gate(sample: Sample, power: float) -> str | None:
    """Reason not to learn from a sample, or None."""
    if sample.speed < REVERSE_SPEED:
        return "reverse"
    if abs(sample.speed) < STANDSTILL_SPEED and power < CHARGING_POWER:
        return "charging"
    return None


def gate_interval(interval: Interval) -> str | None:
    """Reason not to learn from an interval, or None."""
    if interval.leaps:
        return "speed_leaps"
    if interval.steps.distance.min() < REVERSE_STEP:
        return "reverse"
    standing = interval.distance < STANDSTILL_SPEED * interval.duration
    if standing and interval.energy < CHARGING_POWER * interval.duration:
        return "charging"
    return None
