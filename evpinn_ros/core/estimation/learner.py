"""Interface of the two modes, which the online estimator drives."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from evpinn_ros.core.estimation.breakdown import Breakdowns, EndedDrive
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.estimate import ParameterSet
from evpinn_ros.core.estimation.evidence import NO_EVIDENCE, Evidence
from evpinn_ros.core.estimation.payload import PayloadChange
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.sample import Measured, Sample, Samples
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED

REVERSE_SPEED = -0.1  # m/s: below this the car reverses
REVERSE_STEP = -0.1  # m, the same for a step of an interval
CHARGING_POWER = -500.0  # W at standstill: below this the battery is being charged
STATE_VERSION = 11


@dataclass(frozen=True, slots=True)
class Span:
    """Samples of a part of a drive, to be predicted and learned from in order of stamps.

    Attributes:
        newest: n samples of the newest speeds, to be predicted.
        newest_place: number of smoothed samples before each, shape (n,).
        newest_learned: number of measured samples learned from before each, shape (n,).
        smoothed: m smoothed samples, to be predicted.
        measured: k smoothed samples, of this span or earlier, to learn from.
        power: their battery power, W, shape (k,).
        place: number of smoothed samples before each is learned from, shape (k,).
        battery_ns: stamp of the last battery reading up to each smoothed sample, `NEVER` before
            the first, shape (m,).
    """

    newest: Samples
    newest_place: np.ndarray
    newest_learned: np.ndarray
    smoothed: Samples
    measured: Samples
    power: np.ndarray
    place: np.ndarray
    battery_ns: np.ndarray

    def cut(self, count: int) -> tuple[Span, Span]:
        """The span up to `count` smoothed samples, and the rest."""
        ends = (
            int(self.newest_place.searchsorted(count, side="right")),
            count,
            int(self.place.searchsorted(count, side="right")),
        )
        return self.part((0, 0, 0), ends), self.part(ends, self.sizes)

    @property
    def smoothed_learned(self) -> np.ndarray:
        """Number of measured samples learned from before each smoothed one, shape (m,)."""
        counts: np.ndarray = self.place.searchsorted(np.arange(self.smoothed.size), side="right")
        return counts

    @property
    def sizes(self) -> tuple[int, int, int]:
        """n, m and k."""
        return self.newest.size, self.smoothed.size, self.measured.size

    def part(self, begins: tuple[int, int, int], ends: tuple[int, int, int]) -> Span:
        """The part between counts of newest, smoothed and measured samples."""
        if begins == (0, 0, 0) and ends == self.sizes:
            return self
        newest, smoothed, measured = (slice(a, b) for a, b in zip(begins, ends, strict=True))
        return Span(
            self.newest.where(newest),
            self.newest_place[newest] - begins[1],
            self.newest_learned[newest] - begins[2],
            self.smoothed.where(smoothed),
            self.measured.where(measured),
            self.power[measured],
            self.place[measured] - begins[1],
            self.battery_ns[smoothed],
        )


class Predictions(NamedTuple):
    """Predicted power and the model's own 1-sigma, W.

    Attributes:
        newest: at the newest moments, shape (n, 2).
        smoothed: at the smoothed samples, shape (m, 2).
        energies: since the battery was last measured, J, with their 1-sigma, J; NaN where they are
            not known, shape (m, 2).
    """

    newest: np.ndarray
    smoothed: np.ndarray
    energies: np.ndarray


def joined_predictions(parts: Sequence[Predictions]) -> Predictions:
    """Concatenated predictions of consecutive spans."""
    if len(parts) == 1:
        return parts[0]
    return Predictions._make(map(np.concatenate, zip(*parts, strict=True)))


class LearnerReport(NamedTuple):
    """Detections of a learner on the car and its signals.

    Attributes:
        payload_change: of this drive against the one before, None when none was found.
        suspicion: name of a fault of the signals that the data suggest, or None.
    """

    payload_change: PayloadChange | None = None
    suspicion: str | None = None


class Learner(Protocol):
    """A mode of learning. Time enters only through the samples' stamps.

    Optional methods have a body here that does nothing.
    """

    gated: Counter[str]
    learns_samples: bool
    """Whether its updates learn from measured samples; else from intervals."""

    def follow(self, span: Span) -> Predictions:
        """Predict the samples of a span, each by what was learned before it, and learn."""

    def predict(self, sample: Sample) -> tuple[float, float]:
        """Power and its 1-sigma, W, at a sample by what is learned now."""

    def add_interval(self, interval: Interval) -> bool:
        """Take an interval, its battery measured or not; returns whether an update is due."""
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
        """Breakdown of this drive and of others before it, summed; None where not known."""
        return None

    def breakdowns(self) -> Breakdowns | None:
        """Breakdowns of the drives that were kept, and of this one, last; None where not known."""
        return None

    def model(self) -> CarModel | None:
        """The car for forecasts; None in `mode: paper`."""
        return None

    def report(self) -> LearnerReport:
        """Changes and faults that were detected so far; none by default."""
        return LearnerReport()

    def forget_window(self) -> None:
        """Drop recent samples after a jump of time; keep what was learned."""

    def end_drive(self) -> None:
        """Begin another drive, whatever its stamps."""
        return

    def saved(self) -> Any:
        """State to save (see `common.saved_fields`)."""

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from a saved state; ValueError if it does not fit."""


def gates(samples: Samples, power: np.ndarray) -> list[str | None]:
    """Reasons not to learn from samples, or None."""
    standing = np.abs(samples.speed) < STANDSTILL_SPEED
    charging = standing & (power < CHARGING_POWER)
    reverse = samples.speed < REVERSE_SPEED
    if not (charging.any() or reverse.any()):
        return [None] * samples.size
    return [
        "reverse" if back else "charging" if charges else None
        for back, charges in zip(reverse.tolist(), charging.tolist(), strict=True)
    ]


def admitted(measured: Measured) -> np.ndarray:
    """Which samples may be learned from, shape (n,)."""
    return np.array([reason is None for reason in gates(measured.samples, measured.power)], bool)


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
