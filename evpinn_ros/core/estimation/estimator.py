"""The online estimator: readings in, predicted power and parameters out.

One object serves the node, the replay and the benchmarks, so they give the same numbers. It holds
no clock: stamps are the only time. Once a second of stamps (a tick) it takes the result of the
update begun at the tick before and begins the next. So a result always takes effect one second
after its data, whether it took 5 ms or 900 ms to compute, and live equals replayed.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field, replace
from enum import Enum
from importlib import import_module
import math
from typing import Annotated, Any, NamedTuple, TypeAlias

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.core.estimation.breakdown import Breakdown, Breakdowns, EndedDrive
from evpinn_ros.core.estimation.calibration import BandCalibration, SavedBands
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.estimate import ParameterSet, PowerEstimate, PowerKind, Trust
from evpinn_ros.core.estimation.evidence import Evidence
from evpinn_ros.core.estimation.lag import AlignedBy, Alignment, Lag
from evpinn_ros.core.estimation.learner import (
    STATE_VERSION,
    Learner,
    LearnerReport,
    PowerPrediction,
    gate,
)
from evpinn_ros.core.estimation.operating_range import OperatingRange
from evpinn_ros.core.estimation.size import Similarity
from evpinn_ros.core.estimation.sizing import Sizing
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.detector import BATTERY_STUCK
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    Reading,
    SpeedReading,
    sensor_sigma,
)
from evpinn_ros.core.signals.sample import MeasuredSample, Sample, StreamEvent
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings
from evpinn_ros.core.signals.stuck import StuckDetector
from evpinn_ros.core.vehicle.files import CONSTANTS, GENERIC, Vehicle
from evpinn_ros.core.vehicle.physics import RegenForm

UPDATE_PERIOD_NS = NANOSECONDS  # one windowed update per second
BATTERY_TIMEOUT_NS = 3 * NANOSECONDS  # dropout after which power is only predicted
STALE_AFTER_NS = 300 * NANOSECONDS  # dropout after which parameters count as stale
READINGS_KEPT = 40_000  # at most, of a drive whose lag is not known yet

Output: TypeAlias = PowerEstimate | ParameterSet


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

    `by` is the alignment of the two.
    """

    newest_ns: int | None
    battery_ns: int | None
    battery_gap_ns: int
    by: AlignedBy

    def silent_for(self, duration_ns: int) -> bool:
        """True if the battery has dropped out for this long, by stamps."""
        if self.newest_ns is None or self.battery_ns is None:
            return True
        return self.newest_ns - self.battery_ns > duration_ns


class _Aligned(NamedTuple):
    """A reading by the clock of speed, its own stamp, and the alignment then."""

    reading: Reading
    stamp_ns: int
    by: AlignedBy


class _Arrival(NamedTuple):
    """A reading that came: the events it completed, and what was known then.

    `tick` is the clock where a second of stamps is over, else None.
    """

    stamp_ns: int
    events: list[StreamEvent]
    stuck: StuckDetector
    measured: PowerEstimate | None
    tick: _Clock | None


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
        self._be(self._file)

    @property
    def vehicle(self) -> Vehicle:
        """What it is learned as: the vehicle file, or a vehicle of another size."""
        return self._vehicle

    def _be(self, vehicle: Vehicle) -> None:
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
            deque(self._handle(interval, self._stuck), maxlen=0)
        deque(self._tick(self._clock), maxlen=0)  # takes the update before and begins the last
        (parameters,) = self._tick(self._clock)
        return self._similarity.estimate(parameters)

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
        self._predictions: dict[PowerKind, deque[tuple[Sample, PowerPrediction]]] = {
            kind: deque(maxlen=2000) for kind in self._bands
        }
        # Readings of a drive whose lag is not known yet, and what was known before them.
        self._recent: list[Reading] | None = []
        self._before: _Learned | None = None

    def add_reading(self, reading: Reading) -> Iterator[Output]:
        """Take one reading: a block of one."""
        return (output for outputs in self.add_block([reading]) for output in outputs)

    def add_block(self, readings: Iterable[Reading]) -> Iterator[Iterator[Output]]:
        """Take readings in the order they came; give the outputs of each, in order.

        How readings are cut into blocks changes no output. What was learned, at any moment, is
        what the output given last rests on.
        """
        block: list[Reading] = []
        for reading in readings:
            if self._sizing is not None and self._sizing.is_due(reading):
                yield from self._add(block)
                block = []
                self._find_size()
            block.append(reading)
        yield from self._add(block)

    def _find_size(self) -> None:
        """Learn this drive anew once its vehicle is seen to be of another size than the file's."""
        if self._sizing is None:
            return
        size, readings = self._sizing.look(), self._sizing.readings
        if self._sizing.over:
            self._sizing = None
        if size is not None:
            self._be(self._file.of_size(size.value))
            self._updates = self._accepted = 0
            self._rejected.clear()
            with self._updates_at_once():
                deque(self._add(readings), maxlen=0)

    def _add(self, readings: Sequence[Reading]) -> Iterator[Iterator[Output]]:
        """Take readings of a vehicle whose size is not looked for among them."""
        if self._sizing is not None and self.enabled:
            self._sizing.readings += readings
        block: list[_Aligned] = []
        for reading in map(self._similarity.reading, readings):
            if self._align(reading):
                yield from self._add_aligned(block)
                block = []
                self._learn_anew()
            block.append(self._aligned(reading))
        yield from self._add_aligned(block)

    def _align(self, reading: Reading) -> bool:
        """Learn the lag from a reading; True if all before it shall be learned anew."""
        if self._settings.mode is Mode.PAPER:
            return False
        anew = self._alignment.add_reading(reading)
        if self._recent is None or anew:
            return anew and self._before is not None
        if self._alignment.settled or len(self._recent) == READINGS_KEPT:
            self._recent = self._before = None
            return False
        if not self._recent:
            self._before = deepcopy(_Learned(self._learner, self._bands, self._seen))
        self._recent.append(reading)
        return False

    def _aligned(self, reading: Reading) -> _Aligned:
        alignment = self._alignment
        return _Aligned(alignment.aligned(reading), reading.stamp_ns, alignment.now)

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
        block = list(map(self._aligned, recent))
        with self._updates_at_once():
            deque(self._add_aligned(block), maxlen=0)
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

    def _add_aligned(self, block: Sequence[_Aligned]) -> Iterator[Iterator[Output]]:
        """Take readings of the similar car by one clock; give the outputs of each, in order."""
        arrivals: list[_Arrival] = []
        self._stream.look_ahead(aligned.reading for aligned in block)
        learns, news = self._learner.learns, False
        for aligned in block:
            arrival = self._arrive(*aligned)
            arrivals.append(arrival)
            news = news or any(isinstance(event, learns) for event in arrival.events)
            # An update may begin or end now, and what follows is predicted with its result.
            if arrival.tick is not None and (news or self._news or self._waiting):
                yield from self._act(arrivals)
                arrivals, news = [], False
        yield from self._act(arrivals)

    def _arrive(self, reading: Reading, measured_ns: int, by: AlignedBy) -> _Arrival:
        """Take a reading of the similar car into the stream; its own stamp is `measured_ns`."""
        events = self._stream.add_reading(reading)
        taken = self._stream.taken
        if taken:
            self._stuck = self._stuck.after(reading)
        measured = None
        if isinstance(reading, BatteryReading) and taken and self._stuck.detected != BATTERY_STUCK:
            power = self._stream.measured_power(reading)
            sigma = sensor_sigma(power, reading.power_std)
            measured = PowerEstimate(PowerKind.MEASURED, measured_ns, power, sigma)
        ticks = isinstance(reading, SpeedReading) and self._ticks()
        tick = self._clock_by(by) if ticks else None
        return _Arrival(reading.stamp_ns, events, self._stuck, measured, tick)

    def _act(self, arrivals: list[_Arrival]) -> Iterator[Iterator[Output]]:
        """Predict and learn; give the outputs of each arrival."""
        samples = [e for arrival in arrivals for e in arrival.events if isinstance(e, Sample)]
        if samples:
            self._learner.expect(samples)
        for arrival in arrivals:
            outputs = (self._similarity.estimate(output) for output in self._outputs(arrival))
            yield outputs
            deque(outputs, maxlen=0)  # which the caller left

    def _outputs(self, arrival: _Arrival) -> Iterator[Output]:
        """Outputs of the similar car after one of its readings."""
        if (measured := arrival.measured) is not None and not math.isnan(measured.power):
            self._learner.battery_measured(arrival.stamp_ns)
            yield measured
        for event in arrival.events:
            yield from self._handle(event, arrival.stuck)
        if arrival.tick is not None:
            yield from self._tick(arrival.tick)

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
        breakdowns = self._learner.together(before)
        if breakdowns is None or self.parameters().parameters["mass"].trust is Trust.INVALID:
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

    def _handle(self, event: StreamEvent, stuck: StuckDetector) -> Iterator[Output]:
        match event:
            case Sample(newest=True):
                yield self._predict(PowerKind.PREDICTED, event)
            case Sample():
                self._learner.advance(event)
                yield self._predict(PowerKind.SMOOTHED, event)
            case MeasuredSample():
                stamp_ns = event.sample.stamp_ns
                if (reason := stuck.why_not(stamp_ns, stamp_ns)) is not None:
                    self._learner.gated[reason] += 1
                    return
                if gate(event.sample, event.power) is None:
                    self._learn_bands(event)
                    if self.enabled:
                        self._seen.add(event.sample)
                if self.enabled:
                    self._learner.observe(event.sample, event.power)
                    self._news |= self._learner.learns is MeasuredSample
            case Interval():
                # Nothing is learned in a dropout, and its energy must have no holes.
                dropout = math.isnan(event.energy)
                sound = stuck.why_not(event.start_ns, event.end_ns) is None
                if dropout or (self.enabled and sound):
                    self._news |= self._learner.add_interval(event)

    def _predict(self, kind: PowerKind, sample: Sample) -> PowerEstimate:
        prediction = self._learner.predict(sample)
        self._predictions[kind].append((sample, prediction))
        sigma = self._bands[kind].sigma(sample, prediction.sigma)
        dropout = prediction.energy, prediction.energy_sigma
        return PowerEstimate(kind, sample.stamp_ns, prediction.power, sigma, *dropout)

    def _learn_bands(self, event: MeasuredSample) -> None:
        """Hold the predictions made for this moment against what was measured."""
        for kind, waiting in self._predictions.items():
            while waiting and waiting[0][0].stamp_ns < event.sample.stamp_ns:
                waiting.popleft()
            if waiting and waiting[0][0].stamp_ns == event.sample.stamp_ns:
                sample, prediction = waiting.popleft()
                self._bands[kind].learn(sample, event.power - prediction.power, prediction.sigma)

    def _ticks(self) -> bool:
        """True once a second of stamps."""
        stamp_ns = self._stream.newest_ns
        if stamp_ns is None:
            return False
        if self._tick_ns is None:
            self._tick_ns = stamp_ns
        passed_ns = stamp_ns - self._tick_ns
        self._tick_ns += passed_ns // UPDATE_PERIOD_NS * UPDATE_PERIOD_NS
        return passed_ns >= UPDATE_PERIOD_NS

    def _tick(self, clock: _Clock) -> Iterator[ParameterSet]:
        """Accept the last update, begin the next, publish the parameters."""
        if self._waiting:
            self._collect()
        if self._news and not self._waiting and self._activity(clock) is not Activity.PAUSED:
            self._news = False
            if (work := self._learner.prepare_update()) is not None:
                self._updates += 1
                self._waiting = True
                self._worker.submit(work)
        yield replace(self._parameters(clock), stamp_ns=clock.newest_ns or 0)

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
        return self._clock_by(self._alignment.now)

    def _clock_by(self, by: AlignedBy) -> _Clock:
        stream = self._stream
        battery_ns = stream.battery_ns
        if battery_ns is not None:
            battery_ns -= by.shift_ns
        return _Clock(stream.newest_ns, battery_ns, stream.battery_gap_ns, by)

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
