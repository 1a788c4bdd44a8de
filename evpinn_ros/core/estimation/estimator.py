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
from dataclasses import dataclass, field, replace
from enum import Enum
from importlib import import_module
import math
from operator import mul
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
from evpinn_ros.core.estimation.estimate import ParameterSet, PowerEstimate, PowerKind, Trust
from evpinn_ros.core.estimation.evidence import Evidence
from evpinn_ros.core.estimation.lag import Aligner, Alignment, Lag
from evpinn_ros.core.estimation.learner import (
    STATE_VERSION,
    Learner,
    LearnerReport,
    Predictions,
    Span,
    admitted,
    joined_predictions,
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
from evpinn_ros.core.estimation.persistence import Persistence
from evpinn_ros.core.estimation.size import Similarity
from evpinn_ros.core.estimation.sizing import Intervals, Sizing
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.arrived_power import NO_BATTERY, ArrivedPower
from evpinn_ros.core.signals.block import Block, joined
from evpinn_ros.core.signals.detector import BATTERY_STUCK
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.kinematics import MAX_ACCELERATION
from evpinn_ros.core.signals.newest import NO_SPEEDS, NewestSpeeds, NewestTrack
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    MotorReading,
    Reading,
    SpeedReading,
    sensor_sigma,
)
from evpinn_ros.core.signals.reorder import Arrived, ReorderBuffer
from evpinn_ros.core.signals.sample import Events, Measured, Newest, Sample, Samples
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings
from evpinn_ros.core.signals.stuck import StuckDetector, Verdict, VerdictCourse
from evpinn_ros.core.signals.track import LATER, NEVER
from evpinn_ros.core.vehicle.files import CONSTANTS, GENERIC, Vehicle
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED, RegenForm

EMPTY = Block(0, {})
UPDATE_PERIOD_NS = NANOSECONDS  # one windowed update per second
BATTERY_TIMEOUT_NS = 3 * NANOSECONDS  # dropout after which power is only predicted
STALE_AFTER_NS = 300 * NANOSECONDS  # dropout after which parameters count as stale


class Mode(str, Enum):
    """Choice of learner (`LEARNERS`)."""

    HYBRID = "hybrid"
    PAPER = "paper"


class PaperOptimizer(str, Enum):
    """Optimizer of `mode: paper` for the network and the parameters on its window."""

    ADAM = "adam"  # as published
    GAUSS_NEWTON = "gauss_newton"  # the same network and loss, much nearer to the minimum


LEARNERS: Mapping[Mode, str] = {
    Mode.HYBRID: "evpinn_ros.core.estimation.hybrid",
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
        regen_form: form of eq. 21; of `mode: paper` alone.
        optimizer: of `mode: paper` alone.
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
        shift: of the battery's stamps that removes the lag, s.
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
    """State of a car: of its learner, its bands, its lag, and its size if that was learned.

    `sizing` holds the intervals from which the size is still estimated; None once it is settled.
    """

    SAME = ("version", "vehicle", "mode")

    version: int
    vehicle: str
    mode: str
    learner: Any
    bands: SavedBands
    lag: Lag | None = None
    size: Annotated[float, Range(*CONSTANTS["relative_size"][:2])] | None = None
    sizing: Intervals | None = None


class _Clock(NamedTuple):
    """A moment of stamps.

    Attributes:
        newest_ns: of the newest speed, None before the first.
        battery_ns: of the newest battery reading by the clock of speed, `NEVER` before the first.
        battery_gap_ns: time without the battery that is a dropout.
        alignment: of the clocks of speed and battery.
    """

    newest_ns: int | None
    battery_ns: int
    battery_gap_ns: int
    alignment: Alignment

    def silent_for(self, duration_ns: int) -> bool:
        """True if the battery has dropped out for this long."""
        return self.newest_ns is None or self.newest_ns - self.battery_ns > duration_ns


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
        self._buffer = ReorderBuffer(self._settings.stream.allowed_lateness)
        self._newest = NewestTrack(self._settings.stream.max_gap, self._file.motor_ratio)
        self._tells_breakdown = False
        self._restart_as(self._file)

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle as it is learned: that of the file, or one of another size."""
        return self._vehicle

    def _restart_as(self, vehicle: Vehicle) -> None:
        """Start anew with this vehicle."""
        self._worker.cancel()
        self._vehicle, self._similarity = vehicle, Similarity(vehicle)
        self._learner = self._settings.new_learner(self._similarity.car)
        settings, motor_ratio = self._settings.stream, vehicle.motor_ratio
        self._stream = SampleStream(settings, vehicle.air_density, motor_ratio)
        self._bands = {k: BandCalibration() for k in (PowerKind.PREDICTED, PowerKind.SMOOTHED)}
        self._seen = OperatingRange()
        self._align(None)
        self._begin_time()

    def _align(self, lag: Lag | None) -> None:
        """Shift the battery to the clock of speed, by the lag that earlier drives showed."""
        self._aligner = Aligner(lag)
        self._buffer.shift_battery(self._aligner.shift_ns)

    def _begin_time(self) -> None:
        """Join nothing to the readings before."""
        self._stuck = StuckDetector()
        self._tick_ns: int | None = None  # of the last second of stamps
        self._first_ns: int | None = None  # of the first speed
        self._persistence = Persistence()
        # Stamps at which the battery measured power, from the last before the smoothed samples.
        self._battery_ns = np.array([NEVER])
        # Intervals for the next tick, each after the stamp that made it ready.
        self._ready: list[tuple[int, Interval]] = []
        self._waiting = False  # for the result of an update
        self._news = False  # True if there are intervals that no update has seen
        self._predictions = dict.fromkeys(self._bands, NO_PREDICTIONS)
        # Columns of `Waiting`, predicted at once and not in `_predictions` yet.
        self._predicted: list[tuple[int, float, float, bool]] = []
        self._surroundings: tuple[list[float], Sample] | None = None  # `SampleStream.around`

    def handle_time_jump(self) -> None:
        """Forget what may not be joined across a jump of time; keep what was learned."""
        self.flush()
        self._worker.cancel()
        self._buffer.reset()
        self._newest = NewestTrack(self._settings.stream.max_gap, self._vehicle.motor_ratio)
        self._stream.reset()
        self._learner.forget_window()
        self._aligner.begin_stretch()
        if self._sizing is not None:
            self._sizing.begin_drive()
        self._begin_time()

    def flush(self) -> Outputs:
        """Process the waiting readings: no more will come, or only after a pause."""
        return self._advance(self._buffer.flush(), NO_SPEEDS)

    def finish(self) -> ParameterSet:
        """Learn the waiting intervals of a drive that is over; returns the parameters then."""
        self.flush()
        self._find_size()
        for interval in (*(ready for _, ready in self._ready), *self._stream.finish()):
            self._add_interval(interval, self._stuck.verdict)
        self._ready = []
        self._tick(self._clock)  # takes the last update but one, and begins the last
        return self._similarity.estimate(self._tick(self._clock))

    def begin_next_drive(self) -> None:
        """Begin another drive of this car, at any stamps."""
        self.finish()
        self.handle_time_jump()
        self._align(self._aligner.saved)
        self._learner.end_drive()

    def clear_counters(self) -> None:
        """Reset all counters, for the next drive."""
        self._updates = self._accepted = 0
        for counter in (self._rejected, self._stream.dropped, self._buffer.dropped):
            counter.clear()
        self._learner.gated.clear()
        self._worker.durations.clear()

    def add_readings(self, readings: Iterable[Reading]) -> list[Output]:
        """Take readings in order of arrival; returns their outputs in order."""
        return [output for _, output in self.add_block(Block.of(readings)).in_order()]

    def add_block(self, block: Block, *, breakdowns: bool = False) -> Outputs:
        """Take readings in order of arrival; how they are cut into blocks changes no output.

        Args:
            block: of the readings.
            breakdowns: whether `Outputs.learned` needs the breakdown.
        """
        self._tells_breakdown = breakdowns
        released, arrived = self._buffer.add(self._aligner.shifted(block))
        powers = self._newest.battery.add(arrived.get(BatteryReading, NO_BATTERY))
        outputs = self._advance(released, self._newest.add(arrived, powers))
        return outputs._replace(measured=self._measured_rows(powers))

    def add_reading(
        self, reading: Reading, *, breakdowns: bool = False
    ) -> tuple[PowerEstimate | None, Outputs | None]:
        """Take one reading as it comes; the outputs are those of `add_block` in another order.

        Returns:
            Power that is measured or predicted at once, and every few tenths of a second the
            outputs that have become complete.
        """
        self._tells_breakdown = breakdowns
        shift_ns = self._aligner.shift_ns
        if shift_ns and isinstance(reading, BatteryReading):
            reading = replace(reading, stamp_ns=reading.stamp_ns + shift_ns)
        known_ns = self._buffer.watermark_ns  # before this reading
        used, released = self._buffer.add_reading(reading)
        now: PowerEstimate | None = None
        if used and isinstance(reading, SpeedReading):
            now = self._predicted_at_once(reading, known_ns)
        elif used and isinstance(reading, BatteryReading):
            now = self._measured_at_once(reading)
        elif used and isinstance(reading, MotorReading):
            self._newest.add_motor(reading)
        if released is None:
            return now, None
        return now, self._advance(released, NO_SPEEDS)

    def _predicted_at_once(self, reading: SpeedReading, known_ns: int) -> PowerEstimate | None:
        """Power at a speed, by scalars and one row of the equation."""
        stamp_ns, speed = reading.stamp_ns, reading.speed
        moved = self._newest.add_speed(stamp_ns, speed)
        if moved is None:  # the first, after a gap, or late: rare, so left to the arrays
            columns = Block.of([reading]).rows[SpeedReading]
            arrived = Arrived(*columns, np.array([known_ns]))
            newest = self._newest.add({SpeedReading: arrived})
            _, *rows = self._advance(EMPTY, newest).predicted
            row = next(zip(*(column.tolist() for column in rows), strict=True), None)
            return None if row is None else PowerEstimate(PowerKind.PREDICTED, *row)
        if self._surroundings is None:
            self._surroundings = self._stream.around(known_ns)
        weights, around = self._surroundings
        acceleration = sum(map(mul, moved.differences, weights))
        if abs(acceleration) > MAX_ACCELERATION:
            return None
        # `kinematics.profile` of one moment; a slope that is NaN is not equal to itself.
        profile = tuple(s - acceleration if s == s else 0.0 for s in moved.slopes)
        sample = around._replace(
            stamp_ns=stamp_ns,
            speed=speed,
            acceleration=acceleration,
            profile=profile,
            motor_power=moved.motor_power,
        )
        power, sigma = self._learner.predict(sample)
        if self._settings.mode is not Mode.PAPER:
            battery_ns, battery = self._newest.battery.before(stamp_ns)
            battery /= self._similarity.size
            if self._stuck.verdict.detected == BATTERY_STUCK:
                battery = math.nan
            power, sigma = self._persistence.add(stamp_ns, power, sigma, battery_ns, battery)
        moving, size = abs(speed) > STANDSTILL_SPEED, self._similarity.size
        self._predicted.append((stamp_ns, power, sigma, moving))
        sigma *= self._bands[PowerKind.PREDICTED].scale(moving=moving)
        return PowerEstimate(PowerKind.PREDICTED, stamp_ns, size * power, size * sigma)

    def _measured_at_once(self, reading: BatteryReading) -> PowerEstimate | None:
        """Power that a battery reading measures; a current alone takes the last voltage."""
        power, age_ns = self._newest.battery.add_reading(reading)
        old = age_ns > self._stream.battery.voltage.gap_ns()
        if old or power != power or self._stuck.verdict.detected == BATTERY_STUCK:
            return None
        stamp_ns = reading.stamp_ns - self._aligner.shift_ns
        size = self._similarity.size
        sigma = size * float(sensor_sigma(power / size, reading.power_std / size))
        return PowerEstimate(PowerKind.MEASURED, stamp_ns, power, sigma)

    def _advance(self, block: Block, newest: NewestSpeeds) -> Outputs:
        """Take readings in order of stamps, and speeds to be predicted at once."""
        self._courses = [VerdictCourse(0, [], [self._stuck.verdict])]
        self._surroundings = None
        if self._predicted:
            columns = (np.array(column) for column in zip(*self._predicted, strict=True))
            kind = PowerKind.PREDICTED
            self._predictions[kind] = self._predictions[kind].and_then(Waiting(*columns))
            self._predicted.clear()
        parts = []
        while self._sizing is not None and (due_ns := self._sizing.due_ns(block)) != LATER:
            part, block = block.until(due_ns)
            predicted, newest = newest.until(due_ns)
            parts.append(self._add(part, predicted))
            self._find_size()
        if block.length or len(newest.stamps):
            parts.append(self._add(block, newest))
        return joined_outputs(parts)

    def _find_size(self) -> None:
        """Learn this drive anew if its vehicle is of another size than that of the file."""
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
                self._add(readings, NO_SPEEDS)

    @contextmanager
    def _updates_at_once(self) -> Iterator[None]:
        """Compute each update at once, because learning a drive anew is not live."""
        worker, self._worker = self._worker, InlineWorker(lambda: 0.0)
        try:
            yield
            if self._waiting:
                self._collect()
        finally:
            self._worker = worker

    def _add(self, block: Block, newest: NewestSpeeds) -> Outputs:
        """Take readings without looking for the size of the vehicle."""
        if self._sizing is not None and self.enabled:
            self._sizing.blocks.append(block)
        block = self._similarity.block(block)
        course = self._stuck.follow(block)
        self._courses.append(course)
        alignments = [(NEVER, self._aligner.now)]
        if self._settings.mode is not Mode.PAPER:
            alignments += self._aligner.learn(block)
        begun = self._seconds_begun(block.of_kind(SpeedReading).stamps)
        events = self._stream.add(block, newest, intervals=len(begun) > 0)
        battery_ns = np.concatenate((self._battery_ns, self._battery_stamps(block, course)))
        measured = self._admitted(events.measured, course)
        learned_from = measured if self.enabled else measured.where(slice(0))
        checked = measured.where(admitted(measured))
        if self.enabled:
            self._seen.add(checked.samples)
        span = _span(events, learned_from, battery_ns)
        # Later samples need the last stamp before them alone.
        self._battery_ns = battery_ns[battery_ns >= span.battery_ns.max(initial=NEVER)]
        self._ready += events.intervals
        ticks = self._ticks(begun, alignments)
        predictions, learned = self._learn(span, events, learned_from, course, ticks)
        moments = events.newest
        newest_rows = self._calibrated(
            PowerKind.PREDICTED, moments.samples, moments.samples.stamp_ns,
            self._persistent(moments, predictions.newest, course),
            checked._replace(place=moments.known_ns.searchsorted(checked.known_ns)),
        )  # fmt: skip
        smoothed_rows = self._calibrated(
            PowerKind.SMOOTHED, events.smoothed, events.smoothed_ns, predictions.smoothed, checked
        )
        energies, sigmas = predictions.energies.T
        smoothed_rows = smoothed_rows._replace(energy=energies, energy_sigma=sigmas)
        size = self._similarity.size
        return Outputs(NO_POWERS, newest_rows.times(size), smoothed_rows.times(size), learned)

    def _persistent(
        self, newest: Newest, predicted: np.ndarray, course: VerdictCourse
    ) -> np.ndarray:
        """Predictions, W, shape (n, 2), with the decaying error of the last battery reading.

        Those of `mode: paper` stay as they are.
        """
        if self._settings.mode is Mode.PAPER:
            return predicted
        battery = newest.battery_power / self._similarity.size
        if not course.is_quiet:
            watermarks = newest.known_ns.tolist()
            battery[[course.at(ns).detected == BATTERY_STUCK for ns in watermarks]] = np.nan
        columns = newest.samples.stamp_ns, *predicted.T, newest.battery_ns, battery
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return np.array([self._persistence.add(*row) for row in rows]).reshape(-1, 2)

    def _battery_stamps(self, block: Block, course: VerdictCourse) -> np.ndarray:
        """Stamps of a block at which the battery measured power, ns."""
        rows = block.of_kind(BatteryReading)
        voltage, current = rows.values[:2]
        measured = ~np.isnan(current)
        alone = measured & np.isnan(voltage)
        if alone.any():
            measured[alone] = ~np.isnan(self._stream.battery.voltage.last(rows.stamps[alone]))
        if not course.is_quiet:
            sound = [course.at(ns).detected != BATTERY_STUCK for ns in rows.stamps.tolist()]
            measured &= np.array(sound, dtype=bool)
        stamps: np.ndarray = rows.stamps[measured]
        return stamps

    def _measured_rows(self, arrived: ArrivedPower) -> PowerRows:
        """Measured power, at the stamps of its readings, in order of arrival."""
        used = ~np.isnan(arrived.power) & (arrived.age_ns <= self._stream.battery.voltage.gap_ns())
        if not all(course.is_quiet for course in self._courses):
            sound = [self._is_sound(ns) for ns in arrived.battery.watermark_ns.tolist()]
            used &= np.array(sound, dtype=bool)
        stamps, power = arrived.battery.stamps[used] - self._aligner.shift_ns, arrived.power[used]
        size = self._similarity.size
        sigma = size * sensor_sigma(power / size, arrived.coarse[used] / size)
        return PowerRows.of(stamps, stamps, power, sigma)

    def _is_sound(self, watermark_ns: int) -> bool:
        """True if the battery was not known to be stuck by the readings up to a stamp."""
        course = next((c for c in reversed(self._courses) if c.begin_ns <= watermark_ns), None)
        return course is None or course.at(watermark_ns).detected != BATTERY_STUCK

    def _admitted(self, measured: Measured, course: VerdictCourse) -> Measured:
        """The measured samples at which no sensor is stuck."""
        if course.is_quiet:
            return measured
        rows = zip(measured.known_ns.tolist(), measured.samples.stamp_ns.tolist(), strict=True)
        reasons = [course.at(known_ns).why_not(stamp_ns, stamp_ns) for known_ns, stamp_ns in rows]
        self._learner.gated.update(reason for reason in reasons if reason is not None)
        return measured.where(np.array([reason is None for reason in reasons], dtype=bool))

    def _learn(
        self,
        span: Span,
        events: Events,
        measured: Measured,
        course: VerdictCourse,
        ticks: Sequence[_Clock],
    ) -> tuple[Predictions, list[Learned]]:
        """Process the block's samples and ticks, with the intervals that are ready by then."""
        learned: list[Learned] = []
        predictions: list[Predictions] = []
        begins = 0, 0, 0
        for clock in ticks:
            known_ns = clock.newest_ns or 0
            ends = (
                int(events.newest.known_ns.searchsorted(known_ns)),
                int(events.smoothed_ns.searchsorted(known_ns, side="right")),
                int(measured.known_ns.searchsorted(known_ns, side="right")),
            )
            if ends != begins:
                predictions.append(self._follow(span.part(begins, ends)))
            begins = ends
            while self._ready and self._ready[0][0] <= known_ns:
                self._add_interval(self._ready.pop(0)[1], course.at(known_ns))
            learned.append(self._learned_outputs(known_ns, self._tick(clock)))
        predictions.append(self._follow(span.part(begins, span.sizes)))
        return joined_predictions(predictions), learned

    def _learned_outputs(self, known_ns: int, parameters: ParameterSet) -> Learned:
        """The outputs of a tick, with parameters of the similar car."""
        breakdown = self._breakdown_beside(parameters) if self._tells_breakdown else None
        estimate = self._similarity.estimate(parameters)
        return Learned(known_ns, estimate, self.detections(), self.model(), breakdown)

    def _follow(self, span: Span) -> Predictions:
        self._news |= self._learner.learns_samples and span.measured.size > 0
        return self._learner.follow(span)

    def _add_interval(self, interval: Interval, stuck: Verdict) -> None:
        """Give the learner an interval, unless a sensor was stuck in it.

        Nothing is learned in a dropout, and its energy must have no holes.
        """
        sound = stuck.why_not(interval.start_ns, interval.end_ns) is None
        if math.isnan(interval.energy) or (self.enabled and sound):
            self._news |= self._learner.add_interval(interval)

    def _calibrated(
        self,
        kind: PowerKind,
        samples: Samples,
        known_ns: np.ndarray,
        predicted: np.ndarray,
        checked: Measured,
    ) -> PowerRows:
        """Predictions with calibrated 1-sigma, each by what was known before.

        Args:
            kind: of the predictions.
            samples: that are predicted.
            known_ns: stamps of the speeds that complete them, shape (n,).
            predicted: power, W, and the model's 1-sigma, W, shape (n, 2).
            checked: samples of known power, with the number of predictions before each as `place`.
        """
        power, sigma = predicted.T
        new = Waiting(samples.stamp_ns, power, sigma, np.abs(samples.speed) > STANDSTILL_SPEED)
        waiting = self._predictions[kind].and_then(new)
        stamps = checked.samples.stamp_ns
        index = waiting.stamp_ns.searchsorted(stamps)
        was_predicted = np.append(waiting.stamp_ns, NEVER)[index] == stamps
        checked, index = checked.where(was_predicted), index[was_predicted]
        error = np.abs(checked.power - waiting.power[index])
        columns = checked.place, waiting.moving[index], error, waiting.sigma[index]
        lessons = [*map(Checked, *(column.tolist() for column in columns))]
        self._predictions[kind] = waiting.after(index)
        calibrated = self._bands[kind].calibrated(new.moving, sigma, lessons)
        return PowerRows.of(known_ns, samples.stamp_ns, power, calibrated)

    def parameters(self) -> ParameterSet:
        """Present estimate of the parameters."""
        return self._similarity.estimate(self._parameters(self._clock))

    def _parameters(self, clock: _Clock) -> ParameterSet:
        """Parameters of the similar car."""
        parameters = replace(self._learner.parameters(), lag=clock.alignment.lag)
        if clock.alignment.doubtful:
            parameters = parameters.doubted()
        return parameters.stale() if clock.silent_for(STALE_AFTER_NS) else parameters

    def model(self) -> CarModel | None:
        """The car for forecasts of plans; None in `mode: paper`."""
        model = self._learner.model()
        return None if model is None else self._similarity.model(model)

    def drive(self) -> tuple[EndedDrive, ...]:
        """Parts of this drive so far, to be kept for `breakdown`."""
        return self._learner.drive()

    def breakdown(self, before: Sequence[EndedDrive] = ()) -> Breakdown | None:
        """Breakdown of the energy of this drive, with that of drives before it.

        None in `mode: paper`, before the first interval, and while the mass is invalid, which
        means another car or a wrong signal.
        """
        return self._breakdown_beside(self._parameters(self._clock), before)

    def _breakdown_beside(
        self, parameters: ParameterSet, before: Sequence[EndedDrive] = ()
    ) -> Breakdown | None:
        """`breakdown`, given the parameters of the similar car."""
        breakdowns = self._learner.together(before)
        if breakdowns is None or parameters.parameters["mass"].trust is Trust.INVALID:
            return None
        return self._similarity.breakdowns(breakdowns).of(0)

    def breakdowns(self) -> Breakdowns | None:
        """Breakdowns of all drives that were kept, the present one last; None in `mode: paper`."""
        breakdowns = self._learner.breakdowns()
        return None if breakdowns is None else self._similarity.breakdowns(breakdowns)

    def evidence(self) -> Evidence:
        """Likelihood of the parameters without their prior (see `estimation.evidence`)."""
        return self._learner.evidence()

    def detections(self) -> LearnerReport:
        """Changes of payload and suspicions."""
        return self._similarity.report(self._learner.report())

    def status(self) -> EstimatorStatus:
        """Activity, counters and trust, for diagnostics."""
        parameters = self.parameters().parameters
        return EstimatorStatus(
            activity=self._activity(self._clock),
            dropped=dict(self._buffer.dropped + self._stream.dropped),
            gated=dict(self._learner.gated),
            updates=self._updates,
            accepted=self._accepted,
            rejected=dict(self._rejected),
            durations=tuple(self._worker.durations),
            newest_ns=self._newest.newest_ns,
            unknown=self._stream.unknown,
            report=self.detections(),
            progress={name: p.progress for name, p in parameters.items()},
            trust={name: p.trust for name, p in parameters.items()},
            seen=self._seen.counts(),
            band_coverage={kind.value: band.coverage for kind, band in self._bands.items()},
            stuck=self._stuck.verdict.detected,
            lag=self._aligner.now.lag,
            shift=self._aligner.shift_ns / NANOSECONDS,
        )

    def saved(self) -> SavedEstimator:
        """The car by its mode and vehicle file, its bands and its lag."""
        bands = SavedBands(*(band.saved() for band in self._bands.values()))
        key, mode = self._vehicle.key, self._settings.mode.value
        lag = self._aligner.saved
        size = None if self._vehicle is self._file else self._vehicle.relative_size
        sizing = None if self._sizing is None else self._sizing.intervals()
        learner = self._learner.saved()
        return SavedEstimator(STATE_VERSION, key, mode, learner, bands, lag, size, sizing)

    def take(self, saved: SavedEstimator) -> None:
        """Go on from a saved state; if this raises, nothing has changed."""
        vehicle = self._file if saved.size is None else self._file.of_size(saved.size)
        learner = self._settings.new_learner(Similarity(vehicle).car)
        learner.gated = self._learner.gated
        learner.restore(saved.learner)
        sizing = None if saved.sizing is None else Sizing(saved.sizing)
        self.handle_time_jump()
        self._sizing = sizing
        self._learner = learner
        self._align(saved.lag)
        self._vehicle, self._similarity = vehicle, Similarity(vehicle)
        self._bands[PowerKind.PREDICTED].take(saved.bands.predicted)
        self._bands[PowerKind.SMOOTHED].take(saved.bands.smoothed)

    def _seconds_begun(self, stamps: np.ndarray) -> np.ndarray:
        """Stamps of the speeds of a block that begin a second, ns."""
        if not len(stamps):
            return stamps
        if self._first_ns is None:
            self._first_ns = self._tick_ns = int(stamps[0])
        seconds = (stamps - self._first_ns) // UPDATE_PERIOD_NS
        last = ((self._tick_ns or 0) - self._first_ns) // UPDATE_PERIOD_NS
        self._tick_ns = int(stamps[-1])
        return stamps[seconds > np.concatenate(([last], seconds[:-1]))]

    def _ticks(
        self, firsts: np.ndarray, alignments: Sequence[tuple[int, Alignment]]
    ) -> list[_Clock]:
        """A clock for each of `firsts`, by alignments and the stamps from which they hold."""
        if not len(firsts):
            return []
        since = [stamp_ns for stamp_ns, _ in alignments]
        battery = self._stream.battery
        columns = firsts, battery.newest_at(firsts), battery.gap_ns(firsts)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return [
            _Clock(now_ns, battery_ns, gap_ns, alignments[bisect_right(since, now_ns) - 1][1])
            for now_ns, battery_ns, gap_ns in rows
        ]

    def _tick(self, clock: _Clock) -> ParameterSet:
        """Take the result of the last update, begin the next; returns the parameters."""
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
            # The next window may be solvable; until then the earlier estimate stays in use.
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
        battery, newest_ns = self._stream.battery, self._tick_ns
        return _Clock(newest_ns, battery.newest_ns, int(battery.gap_ns()), self._aligner.now)

    def _activity(self, clock: _Clock) -> Activity:
        if clock.newest_ns is None:
            return Activity.WAITING
        if clock.silent_for(max(BATTERY_TIMEOUT_NS, clock.battery_gap_ns)):
            return Activity.PREDICTING
        return Activity.LEARNING if self.enabled else Activity.PAUSED


def _span(events: Events, measured: Measured, battery_ns: np.ndarray) -> Span:
    """The span of events that a learner follows.

    Args:
        events: of a block.
        measured: those of its measured samples that are learned from.
        battery_ns: stamps at which the battery measured power, from the last before the block on.
    """
    newest = events.newest
    stamps = events.smoothed.stamp_ns
    return Span(
        newest=newest.samples,
        newest_place=events.smoothed_ns.searchsorted(newest.known_ns, side="right"),
        newest_learned=measured.known_ns.searchsorted(newest.known_ns, side="right"),
        smoothed=events.smoothed,
        measured=measured.samples,
        power=measured.power,
        place=measured.place,
        battery_ns=battery_ns[np.maximum(battery_ns.searchsorted(stamps, side="right") - 1, 0)],
    )


def evidence_of_state(vehicle: Vehicle, state: Mapping[str, Any]) -> Evidence:
    """Evidence in a saved state of a car, of `mode: hybrid`.

    Raises:
        StateError: the state is of another vehicle or version, or does not fit.
    """
    estimator = OnlineEstimator(vehicle, EstimatorSettings(), InlineWorker(lambda: 0.0))
    estimator.restore(state)
    return estimator.evidence()
