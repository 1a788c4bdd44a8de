"""Interface of the two modes, which the online estimator drives."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple, Protocol

import numpy as np

from evpinn_ros.core.estimation.breakdown import Breakdowns, EndedDrive
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.estimate import ParameterSet
from evpinn_ros.core.estimation.evidence import NO_EVIDENCE, Evidence
from evpinn_ros.core.estimation.payload import PayloadChange
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.sample import NO_SAMPLES, Events, Measured, Samples
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED

REVERSE_SPEED = -0.1  # m/s: below this the car reverses
REVERSE_STEP = -0.1  # m, the same for a step of an interval
CHARGING_POWER = -500.0  # W at standstill: below this the battery is being charged
STATE_VERSION = 10


class Step(IntEnum):
    """Kind of what happens to a learner."""

    BATTERY = 0  # the battery was measured, whether or not that is learned from
    NEWEST = 1  # the newest moment is to be predicted
    SMOOTHED = 2  # time passes up to a smoothed sample, which is to be predicted
    MEASURED = 3  # a smoothed sample whose power is known is to be learned from


@dataclass(frozen=True, slots=True)
class Moments:
    """What happens along a block, in order.

    Attributes:
        newest: n newest moments.
        smoothed: m smoothed samples.
        measured: k of them, to learn from.
        power: their battery power, W, shape (k,).
        battery_ns: stamps at which the battery was measured.
        steps: kind of each step and its place in the column of its kind.
        orders: place of each step in the block.
    """

    newest: Samples
    smoothed: Samples
    measured: Samples
    power: np.ndarray
    battery_ns: Sequence[int]
    steps: Sequence[tuple[Step, int]]
    orders: Sequence[int]

    @classmethod
    def of(cls, events: Events, measured: Measured, told: tuple[np.ndarray, ...]) -> Moments:
        """What readings complete.

        Args:
            events: of the block.
            measured: of them, those to be learned from.
            told: places and stamps of the battery readings that measure power.
        """
        orders = told[0], events.newest_order, events.smoothed_order, measured.order
        # Of one place first the battery, then the newest moment; a measured sample comes after as
        # many smoothed ones as its battery waited for.
        turns = (
            np.full(len(told[0]), -2),
            np.full(len(events.newest_order), -1),
            2 * np.arange(len(events.smoothed_order)) + 1,
            2 * measured.place,
        )
        kinds = np.repeat(range(len(Step)), [len(column) for column in orders])
        places = np.concatenate([np.arange(len(column)) for column in orders])
        order = np.concatenate(orders)
        sequence = np.lexsort((np.concatenate(turns), order))
        of_kind = tuple(Step)
        steps = [
            (of_kind[kind], place)
            for kind, place in zip(
                kinds[sequence].tolist(), places[sequence].tolist(), strict=True
            )
        ]
        return cls(
            events.newest, events.smoothed, measured.samples, measured.power,
            told[1].tolist(), steps, order[sequence].tolist(),
        )  # fmt: skip


NO_MOMENTS = Moments(NO_SAMPLES, NO_SAMPLES, NO_SAMPLES, np.empty(0), (), (), ())


class Predictions(NamedTuple):
    """Predicted power and the model's own 1-sigma, W; NaN until they are followed.

    Attributes:
        newest: at the newest moments, shape (n, 2).
        smoothed: at the smoothed samples, shape (m, 2).
        energies: since the battery was last measured, J, with their 1-sigma, J; NaN where they are
            not known, shape (m, 2).
    """

    newest: np.ndarray
    smoothed: np.ndarray
    energies: np.ndarray

    @classmethod
    def of(cls, moments: Moments) -> Predictions:
        """None of a block yet."""
        sizes = moments.newest.size, moments.smoothed.size, moments.smoothed.size
        return cls(*(np.full((size, 2), np.nan) for size in sizes))


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
    learns_samples: bool
    """Whether its updates learn from measured samples; else from intervals."""

    def begin(self, moments: Moments) -> Predictions:
        """Begin to follow a block; gives the predictions, which `follow` fills."""

    def follow(self, first: int, last: int) -> None:
        """Let the steps from one place to before another happen: predict, and learn."""

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
