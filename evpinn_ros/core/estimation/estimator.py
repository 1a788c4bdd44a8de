"""The online estimator: readings in, predicted power and parameters out.

One object serves the node, the replay and the benchmarks, so they give the same numbers. It holds
no clock: stamps are the only time. Once a second of stamps (a tick) it takes the result of the
update begun at the tick before and begins the next. So a result always takes effect one second
after its data, whether it took 5 ms or 900 ms to compute, and live equals replayed.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field, replace
from enum import Enum
from importlib import import_module
import math
from operator import itemgetter
from typing import Annotated, Any, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.core.estimation.breakdown import Breakdown, Breakdowns, EndedDrive
from evpinn_ros.core.estimation.calibration import (
    NO_PREDICTIONS,
    BandCalibration,
    Checked,
    SavedBands,
    Waiting,
)
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.estimate import ParameterSet, PowerKind, Trust
from evpinn_ros.core.estimation.evidence import Evidence
from evpinn_ros.core.estimation.lag import Aligned, AlignedBy, Alignment, Lag
from evpinn_ros.core.estimation.learner import (
    STATE_VERSION,
    Learner,
    LearnerReport,
    Moments,
    Step,
    admitted,
)
from evpinn_ros.core.estimation.operating_range import OperatingRange
from evpinn_ros.core.estimation.outputs import (
    NO_POWERS,
    Learned,
    Output,
    Outputs,
    PowerRows,
    joined_outputs,
)
from evpinn_ros.core.estimation.size import Similarity
from evpinn_ros.core.estimation.sizing import Sizing
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.block import Block, joined
from evpinn_ros.core.signals.detector import BATTERY_STUCK
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    Reading,
    SpeedReading,
    sensor_sigma,
)
from evpinn_ros.core.signals.sample import Events, Measured, Samples
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings
from evpinn_ros.core.signals.stuck import StuckCourse, StuckDetector
from evpinn_ros.core.signals.track import NEVER
from evpinn_ros.core.vehicle.files import CONSTANTS, GENERIC, Vehicle
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED, RegenForm

UPDATE_PERIOD_NS = NANOSECONDS  # one windowed update per second
BATTERY_TIMEOUT_NS = 3 * NANOSECONDS  # dropout after which power is only predicted
STALE_AFTER_NS = 300 * NANOSECONDS  # dropout after which parameters count as stale
READINGS_KEPT = 40_000  # at most, of a drive whose lag is not known yet


class Mode(str, Enum):
    """Choice of learner (`LEARNERS`)."""

    HYBRID = "hybrid"
    PAPER = "paper"


class PaperOptimizer(str, Enum):
    """Optimizer of `mode: paper` for the network and the parameters on its window."""

    ADAM = "adam"  # as published
    GAUSS_NEWTON = "gauss_newton"  # the same network and loss, much nearer to the minimum


LEARNERS: Mapping[Mode, str] = {
    Mode.HYBRID: "evpinn_ros.core.estimation.pinn",
    Mode.PAPER: "evpinn_ros.extras.paper.learner",  # loads torch
}
"""Module of each mode, imported when it is asked for, and its `new_learner(vehicle, settings)`."""


class Activity(str, Enum):
    """Present activity of the estimator."""

    WAITING = "waiting"
    LEARNING = "learning"
    PREDICTING = "predicting"
    PAUSED = "paused"


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """Settings of an estimator.

    Attributes:
        seed: of the networks.
        stream: how readings become samples.
        keep_drives: whether breakdowns of earlier drives are kept, to be compared; hybrid alone.
        mode: how to learn.
        regen_form: reading of eq. 21; `mode: paper` alone.
        optimizer: what trains; `mode: paper` alone.
    """

    seed: int = 0
    stream: StreamSettings = field(default_factory=StreamSettings)
    keep_drives: bool = False
    mode: Mode = Mode.HYBRID
    regen_form: RegenForm = RegenForm.RECOVERY
    optimizer: PaperOptimizer = PaperOptimizer.ADAM

    def new_learner(self, vehicle: Vehicle) -> Learner:
        """A learner that knows the vehicle file alone."""
        learner: Learner = import_module(LEARNERS[self.mode]).new_learner(vehicle, self)
        return learner


@dataclass(frozen=True, slots=True)
class EstimatorStatus:
    """Status of the estimator for diagnostics.

    Attributes:
        activity: what it is doing.
        dropped: readings not used, by reason.
        gated: samples not learned from, by reason.
        updates: windowed updates begun.
        accepted: updates accepted.
        rejected: updates rejected, by reason.
        durations: seconds that each of the latest updates took (`worker.DURATIONS_KEPT`).
        report: changes of payload and suspicions.
        progress: percent learned of each parameter.
        trust: of each parameter.
        seen: samples learned from, by speed and acceleration.
        band_coverage: share of recent samples inside the 90 % band, by kind of prediction.
        newest_ns: stamp of the newest speed, None before the first.
        unknown: optional inputs without data (see `Road.unknown`).
        stuck: name of the signal that repeats one value (see `signals.stuck`), or None.
        lag: of speed to battery, None while unknown.
        shift: of the battery's stamps that takes it out, s.
    """

    activity: Activity
    dropped: Mapping[str, int]
    gated: Mapping[str, int]
    updates: int
    accepted: int
    rejected: Mapping[str, int]
    durations: tuple[float, ...]
    newest_ns: int | None
    unknown: tuple[str, ...] = ()
    report: LearnerReport = field(default_factory=LearnerReport)
    progress: Mapping[str, float] = field(default_factory=dict)
    trust: Mapping[str, Trust] = field(default_factory=dict)
    seen: Mapping[str, int] = field(default_factory=dict)
    band_coverage: Mapping[str, float] = field(default_factory=dict)
    stuck: str | None = None
    lag: Lag | None = None
    shift: float = 0.0


@dataclass(frozen=True, slots=True)
class SavedEstimator:
    """State of a car: that of its learner, the bands, its lag, its size where it was learned."""

    SAME = ("version", "vehicle", "mode")

    version: int
    vehicle: str
    mode: str
    learner: Any
    bands: SavedBands
    lag: Lag | None = None
    size: Annotated[float, Range(*CONSTANTS["relative_size"][:2])] | None = None


class _Clock(NamedTuple):
    """Stamps of the newest speed and battery reading, and the gap that is a dropout, ns.

    The battery is by the clock of speed, which `by` aligned it to.
    """

    newest_ns: int | None
    aligned_battery_ns: int | None
    battery_gap_ns: int
    by: AlignedBy

    def silent_for(self, duration_ns: int) -> bool:
        """True if the battery has dropped out for this long, by its own stamps."""
        if self.newest_ns is None or self.aligned_battery_ns is None:
            return True
        return self.newest_ns - (self.aligned_battery_ns - self.by.shift_ns) > duration_ns


class _Tick(NamedTuple):
    """A second of stamps that is over: the place of the speed that ended it, and the clock."""

    place: int
    clock: _Clock


class _Learned(NamedTuple):
    """What is learned of a drive's readings."""

    learner: Learner
    bands: dict[PowerKind, BandCalibration]
    seen: OperatingRange


class OnlineEstimator(Saveable[SavedEstimator]):
    """One car, learned from its readings: predictions at once, parameters once a second."""

    def __init__(
        self, vehicle: Vehicle, settings: EstimatorSettings, worker: InlineWorker
    ) -> None:
        """Start from the vehicle's priors; the worker computes the updates."""
        self._file, self._settings, self._worker = vehicle, settings, worker
        self._accepted = 0
        self._updates = 0
        self._rejected: Counter[str] = Counter()
        self.enabled = True
        self.reset()

    def reset(self) -> None:
        """Forget all that was learned; counters are kept."""
        sizes = self._file.key == GENERIC and self._settings.mode is Mode.HYBRID
        self._sizing = Sizing() if sizes else None
        self._restart_as(self._file)

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest speed, None before the first."""
        return self._stream.newest_ns

    @property
    def vehicle(self) -> Vehicle:
        """What it is learned as: the vehicle file, or a vehicle of another size."""
        return self._vehicle

    def _restart_as(self, vehicle: Vehicle) -> None:
        """Know this vehicle alone."""
        self._worker.cancel()
        self._vehicle, self._similarity = vehicle, Similarity(vehicle)
        self._learner = self._settings.new_learner(self._similarity.car)
        self._stream = SampleStream(
            self._settings.stream, self._vehicle.air_density, self._vehicle.motor_ratio
        )
        self._bands = {k: BandCalibration() for k in (PowerKind.PREDICTED, PowerKind.SMOOTHED)}
        self._seen = OperatingRange()
        self._alignment = Alignment()
        self._begin_time()

    def handle_time_jump(self) -> None:
        """Forget what may not be joined across a jump of time; keep what was learned."""
        self._worker.cancel()
        self._stream.reset()
        self._learner.forget_window()
        self._alignment.begin_stretch()
        self._sizing = None  # the rest of the drive was learned as the vehicle that it is now
        self._begin_time()

    def finish(self) -> ParameterSet:
        """Learn what waits for more of a drive that is over; gives the parameters then."""
        self._find_size()
        for interval in self._stream.finish():
            self._add_interval(interval, self._stuck)
        self._tick(self._clock)  # takes the update before and begins the last
        return self._similarity.estimate(self._tick(self._clock))

    def begin_next_drive(self) -> None:
        """Begin another drive of this car; the same holds for the stamps."""
        self.finish()
        self.handle_time_jump()
        self._alignment = self._alignment.next_drive()
        self._learner.end_drive()

    def clear_counters(self) -> None:
        """Count anew, for the next drive."""
        self._updates = self._accepted = 0
        self._rejected.clear()
        self._stream.dropped.clear()
        self._learner.gated.clear()
        self._worker.durations.clear()

    def _begin_time(self) -> None:
        self._stuck = StuckDetector()
        self._tick_ns: int | None = None
        self._waiting = False
        self._news = False  # whether there is anything that no update has seen
        self._predictions = dict.fromkeys(self._bands, NO_PREDICTIONS)
        # Readings of a drive whose lag is not known yet, and what was known before them.
        self._recent: list[Block] | None = []
        self._remembered = 0
        self._before: _Learned | None = None

    def add_readings(self, readings: Iterable[Reading]) -> list[Output]:
        """Take readings in the order they came; give what they lead to, in order."""
        return [output for _, output in self.add_block(Block.of(readings)).by_place()]

    def add_block(self, block: Block, *, breakdowns: bool = False) -> Outputs:
        """Take readings in the order they came; how they are cut into blocks changes no output.

        Args:
            block: of the readings.
            breakdowns: whether the breakdown is asked for once a second.
        """
        self._tells_breakdown = breakdowns
        parts: list[tuple[int, Outputs]] = []
        first = 0
        while first < block.length:
            rest = block.part(first, block.length)
            count = rest.length if self._sizing is None else self._sizing.until_due(rest)
            parts += (
                (first + begin, outputs) for begin, outputs in self._add(rest.part(0, count))
            )
            if count < rest.length:
                self._find_size()
            first += count
        return joined_outputs(parts)

    def _find_size(self) -> None:
        """Learn this drive anew once its vehicle is seen to be of another size than the file's."""
        if self._sizing is None:
            return
        size, readings = self._sizing.look(), joined(self._sizing.blocks)
        if self._sizing.over:
            self._sizing = None
        if size is not None:
            self._restart_as(self._file.of_size(size.value))
            self._updates = self._accepted = 0
            self._rejected.clear()
            with self._updates_at_once():
                self._add(readings)

    def _add(self, block: Block) -> list[tuple[int, Outputs]]:
        """Take readings of a vehicle whose size is not looked for among them.

        Gives the outputs of its parts with their first places.
        """
        if self._sizing is not None and self.enabled:
            self._sizing.blocks.append(block)
        block = self._similarity.block(block)
        parts, first = [], 0
        while first < block.length:
            rest = block.part(first, block.length)
            if self._settings.mode is Mode.PAPER:
                aligned = self._alignment.aligned(rest)
            else:
                aligned = self._alignment.add_part(rest)
                self._remember(rest.part(0, aligned.block.length), again=aligned.jumps)
            parts.append((first, self._add_aligned(aligned)))
            first += aligned.block.length
            if aligned.jumps:
                self._learn_anew()
        return parts

    def _remember(self, block: Block, *, again: bool) -> None:
        """Keep readings of a drive whose lag is not known yet; it will be learned `again`."""
        if self._recent is None:
            return
        settled = self._alignment.settled and not again
        self._remembered += block.length
        if settled or self._remembered > READINGS_KEPT:
            self._recent = self._before = None
            return
        if not self._recent:
            self._before = deepcopy(_Learned(self._learner, self._bands, self._seen))
        self._recent.append(block)

    def _learn_anew(self) -> None:
        """Learn the drive so far by the lag that is known now; its outputs were given before."""
        recent, before = self._recent or [], self._before
        if before is None:
            return
        self._worker.cancel()
        dropped, self._stream.dropped = self._stream.dropped, Counter()
        self._stream.reset()
        self._learner, self._bands, self._seen = before
        self._begin_time()
        self._recent = None
        with self._updates_at_once():
            self._add_aligned(self._alignment.aligned(joined(recent)))
        self._stream.dropped = dropped

    @contextmanager
    def _updates_at_once(self) -> Iterator[None]:
        """Compute each update when it is asked for: what is learned anew is not live."""
        worker, self._worker = self._worker, InlineWorker(lambda: 0.0)
        try:
            yield
            if self._waiting:
                self._collect()
        finally:
            self._worker = worker

    def _add_aligned(self, aligned: Aligned) -> Outputs:
        """Take readings of the similar car by one clock."""
        before = self._clock
        events = self._stream.add_block(aligned.block)
        if not (len(events.moments[0]) or len(events.battery[0])):
            return Outputs()  # nothing moved, and nothing was measured
        stuck = self._followed_stuck(aligned.block, events.taken)
        told = self._told(events, stuck)
        measured = self._admitted(events.measured, stuck)
        checkable = admitted(measured)
        learned_from = measured if self.enabled else measured.where(slice(0))
        if len(learned_from.order):
            self._seen.add(learned_from.samples.where(checkable))
        moments = Moments.of(events, learned_from, told[:2])
        predictions = self._learner.begin(moments)
        learned = self._learned(moments, events, stuck, self._ticks(events, aligned, before))
        newest = self._calibrated(
            PowerKind.PREDICTED, events.newest, events.newest_order, predictions.newest, measured,
            checkable,
        )  # fmt: skip
        smoothed = self._calibrated(
            PowerKind.SMOOTHED, events.smoothed, events.smoothed_order, predictions.smoothed,
            measured, checkable,
        )  # fmt: skip
        if smoothed is not NO_POWERS:
            energies = predictions.energies.T
            smoothed = smoothed._replace(energy=energies[0], energy_sigma=energies[1])
        if aligned.shifts.any():
            told = told._replace(stamp_ns=told.stamp_ns - aligned.shift_ns(told.order))
        size = self._similarity.size
        return Outputs(told.times(size), newest.times(size), smoothed.times(size), learned)

    def _followed_stuck(self, block: Block, taken: np.ndarray) -> StuckCourse:
        """The detectors of stuck sensors along the readings that are used."""
        speeds, battery = block.of_kind(SpeedReading), block.of_kind(BatteryReading)
        told = np.isfinite(battery.values[0] * battery.values[1])
        course = self._stuck.course(
            speeds.where(taken[speeds.order]), battery.where(told & taken[battery.order])
        )
        self._stuck = course.last
        return course

    def _told(self, events: Events, stuck: StuckCourse) -> PowerRows:
        """Power that the battery readings measure, by the clock of speed."""
        order, stamps, power, coarse = events.told
        if not len(order):
            return NO_POWERS
        used = ~np.isnan(power)
        if not stuck.is_quiet:
            detected = [stuck.at(place).detected for place in order.tolist()]
            used &= np.array([fault != BATTERY_STUCK for fault in detected], dtype=bool)
        order, stamps, power, coarse = (c[used] for c in (order, stamps, power, coarse))
        unknown = np.full(len(order), np.nan)
        return PowerRows(order, stamps, power, sensor_sigma(power, coarse), unknown, unknown)

    def _admitted(self, measured: Measured, stuck: StuckCourse) -> Measured:
        """The measured samples at which no sensor is stuck."""
        if stuck.is_quiet:
            return measured
        rows = zip(measured.order.tolist(), measured.samples.stamp_ns.tolist(), strict=True)
        reasons = [stuck.at(place).why_not(stamp_ns, stamp_ns) for place, stamp_ns in rows]
        self._learner.gated.update(reason for reason in reasons if reason is not None)
        return measured.where(np.array([reason is None for reason in reasons], dtype=bool))

    def _learned(
        self, moments: Moments, events: Events, stuck: StuckCourse, ticks: Sequence[_Tick]
    ) -> list[Learned]:
        """Let all happen that a block brings, in order; gives what is known once a second."""
        learned: list[Learned] = []
        breaks: list[tuple[int, Interval | _Tick]] = [*events.intervals]
        breaks = sorted([*breaks, *((tick.place, tick) for tick in ticks)], key=itemgetter(0))
        followed = 0
        for place, what in breaks:
            until = bisect_right(moments.orders, place)
            self._follow(moments, followed, until)
            followed = until
            if isinstance(what, Interval):
                self._add_interval(what, stuck.at(place))
            else:
                learned.append(self._told_learned(place, self._tick(what.clock)))
        self._follow(moments, followed, len(moments.orders))
        return learned

    def _told_learned(self, place: int, parameters: ParameterSet) -> Learned:
        """What is known with parameters of the similar car."""
        breakdown = self._breakdown_beside(parameters) if self._tells_breakdown else None
        estimate = self._similarity.estimate(parameters)
        return Learned(place, estimate, self.detections(), self.model(), breakdown)

    def _follow(self, moments: Moments, first: int, last: int) -> None:
        if first == last:
            return
        self._learner.follow(first, last)
        if self._learner.learns_samples:
            self._news |= any(kind is Step.MEASURED for kind, _ in moments.steps[first:last])

    def _add_interval(self, interval: Interval, stuck: StuckDetector) -> None:
        """Let the learner have an interval, unless a sensor was stuck in it.

        Nothing is learned in a dropout, and its energy must have no holes.
        """
        sound = stuck.why_not(interval.start_ns, interval.end_ns) is None
        if math.isnan(interval.energy) or (self.enabled and sound):
            self._news |= self._learner.add_interval(interval)

    def _calibrated(
        self,
        kind: PowerKind,
        samples: Samples,
        order: np.ndarray,
        predicted: np.ndarray,
        measured: Measured,
        checkable: np.ndarray,
    ) -> PowerRows:
        """Predictions with 1-sigma by how errors really spread, each by what was known before.

        Args:
            kind: of the predictions.
            samples: that are predicted.
            order: places at which they are.
            predicted: power, W, and the model's 1-sigma, W, shape (n, 2).
            measured: samples that are known meanwhile.
            checkable: which of them may be learned from, shape (k,).
        """
        if not (len(predicted) or len(measured.order)):
            return NO_POWERS
        power, sigma = predicted.T
        new = Waiting(samples.stamp_ns, power, sigma, np.abs(samples.speed) > STANDSTILL_SPEED)
        waiting = self._predictions[kind].and_then(new)
        stamps = measured.samples.stamp_ns
        index = waiting.stamp_ns.searchsorted(stamps)
        checkable = checkable & (np.append(waiting.stamp_ns, NEVER)[index] == stamps)
        if kind is PowerKind.PREDICTED:
            place = order.searchsorted(measured.order, side="right")
        else:
            place = measured.place
        index, place = index[checkable], place[checkable]
        error = np.abs(measured.power[checkable] - waiting.power[index])
        columns = place, waiting.moving[index], error, waiting.sigma[index]
        checked = map(Checked, *(column.tolist() for column in columns))
        self._predictions[kind] = waiting.after(index)
        calibrated = self._bands[kind].calibrated(new.moving, sigma, list(checked))
        unknown = np.full(len(power), np.nan)
        return PowerRows(order, samples.stamp_ns, power, calibrated, unknown, unknown)

    def parameters(self) -> ParameterSet:
        """Present estimate of the parameters."""
        return self._similarity.estimate(self._parameters(self._clock))

    def _parameters(self, clock: _Clock) -> ParameterSet:
        """Parameters of the similar car."""
        parameters = replace(self._learner.parameters(), lag=clock.by.lag)
        if clock.by.doubtful:
            parameters = parameters.doubted()
        return parameters.stale() if clock.silent_for(STALE_AFTER_NS) else parameters

    def model(self) -> CarModel | None:
        """The car as forecasts of plans take it; None in the paper's mode."""
        model = self._learner.model()
        return None if model is None else self._similarity.model(model)

    def drive(self) -> tuple[EndedDrive, ...]:
        """Parts of this drive so far, to be kept for `breakdown`."""
        return self._learner.drive()

    def breakdown(self, before: Sequence[EndedDrive] = ()) -> Breakdown | None:
        """Energy of this drive by where it went; with drives before it, of all of them.

        None in the paper's mode, before any, and while the mass is invalid: then the car is
        another one, or a signal is wrong, and what rests on them answers nothing.
        """
        return self._breakdown_beside(self._parameters(self._clock), before)

    def _breakdown_beside(
        self, parameters: ParameterSet, before: Sequence[EndedDrive] = ()
    ) -> Breakdown | None:
        """`breakdown` by what the parameters of the similar car are worth."""
        breakdowns = self._learner.together(before)
        if breakdowns is None or parameters.parameters["mass"].trust is Trust.INVALID:
            return None
        return self._similarity.breakdowns(breakdowns).of(0)

    def breakdowns(self) -> Breakdowns | None:
        """Those of all drives that were kept, the present one last."""
        breakdowns = self._learner.breakdowns()
        return None if breakdowns is None else self._similarity.breakdowns(breakdowns)

    def evidence(self) -> Evidence:
        """Likelihood of the parameters without their prior (see `estimation.evidence`)."""
        return self._learner.evidence()

    def detections(self) -> LearnerReport:
        """Changes of payload and suspicions."""
        return self._similarity.report(self._learner.report())

    def status(self) -> EstimatorStatus:
        """Counters and activity."""
        parameters = self.parameters().parameters
        return EstimatorStatus(
            activity=self._activity(self._clock),
            dropped=dict(self._stream.dropped),
            gated=dict(self._learner.gated),
            updates=self._updates,
            accepted=self._accepted,
            rejected=dict(self._rejected),
            durations=tuple(self._worker.durations),
            newest_ns=self._stream.newest_ns,
            unknown=self._stream.unknown,
            report=self.detections(),
            progress={name: p.progress for name, p in parameters.items()},
            trust={name: p.trust for name, p in parameters.items()},
            seen=self._seen.counts(),
            band_coverage={kind.value: band.coverage for kind, band in self._bands.items()},
            stuck=self._stuck.detected,
            lag=self._alignment.lag,
            shift=self._alignment.shift_ns / NANOSECONDS,
        )

    def saved(self) -> SavedEstimator:
        """State to save."""
        bands = SavedBands(*(band.saved() for band in self._bands.values()))
        key, mode = self._vehicle.key, self._settings.mode.value
        lag = self._alignment.saved
        size = None if self._vehicle is self._file else self._vehicle.relative_size
        return SavedEstimator(STATE_VERSION, key, mode, self._learner.saved(), bands, lag, size)

    def take(self, saved: SavedEstimator) -> None:
        """Go on from a saved state; when that raises nothing is changed."""
        vehicle = self._file if saved.size is None else self._file.of_size(saved.size)
        learner = self._settings.new_learner(Similarity(vehicle).car)
        learner.gated = self._learner.gated
        learner.restore(saved.learner)
        self.handle_time_jump()
        self._learner, self._alignment = learner, Alignment(saved.lag)
        self._vehicle, self._similarity = vehicle, Similarity(vehicle)
        self._bands[PowerKind.PREDICTED].take(saved.bands.predicted)
        self._bands[PowerKind.SMOOTHED].take(saved.bands.smoothed)

    def _ticks(self, events: Events, aligned: Aligned, before: _Clock) -> list[_Tick]:
        """The seconds of stamps that end in a block, whose battery was that of a clock before."""
        places, newest = events.moments
        if not len(newest):
            return []
        if self._tick_ns is None:
            self._tick_ns = int(newest[0])
        ticks = []
        while newest[-1] - self._tick_ns >= UPDATE_PERIOD_NS:
            index = int(np.searchsorted(newest, self._tick_ns + UPDATE_PERIOD_NS))
            passed_ns = int(newest[index]) - self._tick_ns
            self._tick_ns += passed_ns // UPDATE_PERIOD_NS * UPDATE_PERIOD_NS
            place = int(places[index])
            by = aligned.by(place)
            battery_ns, gap_ns = before.aligned_battery_ns, before.battery_gap_ns
            told = int(np.searchsorted(events.battery[0], place, side="right")) - 1
            if told >= 0:
                battery_ns, gap_ns = (int(column[told]) for column in events.battery[1:])
            ticks.append(_Tick(place, _Clock(int(newest[index]), battery_ns, gap_ns, by)))
        return ticks

    def _tick(self, clock: _Clock) -> ParameterSet:
        """Accept the last update, begin the next, give the parameters."""
        if self._waiting:
            self._collect()
        if self._news and not self._waiting and self._activity(clock) is not Activity.PAUSED:
            self._news = False
            if (work := self._learner.prepare_update()) is not None:
                self._updates += 1
                self._waiting = True
                self._worker.submit(work)
        return replace(self._parameters(clock), stamp_ns=clock.newest_ns or 0)

    def _collect(self) -> None:
        try:
            candidate = self._worker.collect()
        except Exception as error:
            # The next window may well be solvable; what was learned before stays in use.
            self._waiting = False
            self._rejected[f"failed_{type(error).__name__}"] += 1
            return
        if candidate is None:
            self._rejected["overrun"] += 1
            return
        self._waiting = False
        reason = self._learner.consider(candidate)
        if reason is None:
            self._accepted += 1
        else:
            self._rejected[reason] += 1

    @property
    def _clock(self) -> _Clock:
        stream = self._stream
        battery_ns, gap_ns = stream.battery_ns, stream.battery_gap_ns
        return _Clock(stream.newest_ns, battery_ns, gap_ns, self._alignment.now)

    def _activity(self, clock: _Clock) -> Activity:
        if clock.newest_ns is None:
            return Activity.WAITING
        if clock.silent_for(max(BATTERY_TIMEOUT_NS, clock.battery_gap_ns)):
            return Activity.PREDICTING
        return Activity.LEARNING if self.enabled else Activity.PAUSED


def evidence_of_state(vehicle: Vehicle, state: Mapping[str, Any]) -> Evidence:
    """Evidence in a saved state of a car, of `mode: hybrid`.

    Raises:
        StateError: it is another vehicle's or version's, or does not fit.
    """
    estimator = OnlineEstimator(vehicle, EstimatorSettings(), InlineWorker(lambda: 0.0))
    estimator.restore(state)
    return estimator.evidence()
