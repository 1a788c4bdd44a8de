"""All methods over one log in one pass, each sample predicted before it is learned from.

The peers share one `SampleStream`; `paper` and `hybrid` run as on board, in an `OnlineEstimator`
whose own stream gives the same samples. Every log starts from the priors of its vehicle.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
import math

import numpy as np

from benchmarks.methods import PEERS, OnlineMethod, peers
from evpinn_ros.energy.quadrature import EnergyIntegral
from evpinn_ros.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.estimation.estimator import Mode, OnlineEstimator
from evpinn_ros.estimation.learner import gate
from evpinn_ros.estimation.worker import Clock, InlineWorker
from evpinn_ros.paper.settings import SETTINGS
from evpinn_ros.replays.history import Columns, Drive, History, PowerSeries
from evpinn_ros.signals.readings import NANOSECONDS, Reading
from evpinn_ros.signals.sample import MeasuredSample, NewestSample, SmoothedSample, StreamEvent
from evpinn_ros.signals.stream import SampleStream, StreamSettings
from evpinn_ros.vehicle.files import Vehicle

LAST_VALUE, RANDOM_SPLIT = "null", "split"
METHODS = (LAST_VALUE, RANDOM_SPLIT, *PEERS, *(mode.value for mode in (Mode.PAPER, Mode.HYBRID)))


@dataclass(frozen=True, slots=True)
class Run:
    """One log after all methods."""

    drive: Drive  # readings of the car; it holds no predictions
    predicted: Mapping[str, Drive]  # for each method the same drive with its predictions
    moments: int  # number of smoothed samples
    stream_s: float  # what the samples themselves took, s
    # what predicting and learning took, s. Of `paper` and `hybrid` it includes the samples; the
    # baselines have none
    method_s: Mapping[str, float]


class Predictions:
    """The series of one method, and the energy they add up to."""

    def __init__(self) -> None:
        self._rows = {PowerKind.SMOOTHED: Columns(4), PowerKind.PREDICTED: Columns(4)}
        self._integral, self._energy = EnergyIntegral(), Columns(3)
        self.seconds = 0.0

    def add(
        self, kind: PowerKind, stamp_ns: int, time: float, power: float, sigma: float, lag: float
    ) -> None:
        """Take a prediction, W, for a stamp that lies `time` after the start of the drive, s."""
        self._rows[kind].add(time, power, sigma, lag)
        if kind is PowerKind.SMOOTHED:
            self._integral.append(stamp_ns, power)
            # The Runge-Kutta network integrates no peer: its column stays unknown.
            self._energy.add(time, self._integral.energy, math.nan)

    def over(self, drive: Drive) -> Drive:
        """The drive with these predictions."""
        smoothed, newest = (PowerSeries(*rows.values().T) for rows in self._rows.values())
        return replace(drive, smoothed=smoothed, newest=newest, energy=self._energy.values())


class OnlineBenchmark:
    """Feeds the readings of one log to all methods."""

    def __init__(self, vehicle: Vehicle, names: Iterable[str], clock: Clock) -> None:
        """Start every method at the vehicle's priors; the clock tells how long each takes."""
        self._clock = clock
        self._history = History()
        self._stream = SampleStream(StreamSettings(), vehicle.air_density)
        self._names = list(names)
        self._peers: dict[str, OnlineMethod] = peers(self._names, vehicle)
        self._estimators = {
            mode.value: OnlineEstimator(vehicle, SETTINGS[mode](), InlineWorker(clock))
            for mode in Mode
            if mode.value in self._names
        }
        running = (*self._peers, *self._estimators)
        self._predictions = {name: Predictions() for name in running}
        self._moments: list[tuple[PowerKind, int, float]] = []
        self._stream_s = 0.0

    def add_reading(self, reading: Reading) -> float:
        """Take one reading; returns s since the first."""
        self._history.add_reading(reading)
        begin = self._clock()
        events = list(self._stream.add_reading(reading))
        self._stream_s += self._clock() - begin
        for event in events:
            self._handle(event, reading.stamp_ns)
        for name, estimator in self._estimators.items():
            begin = self._clock()
            outputs = list(estimator.add_reading(reading))
            self._predictions[name].seconds += self._clock() - begin
            for output in outputs:
                if isinstance(output, PowerEstimate) and output.kind is not PowerKind.MEASURED:
                    self._add(name, output, reading.stamp_ns)
        return self._history.seconds(reading.stamp_ns)

    def finish(self) -> Run:
        """The series of all methods."""
        drive = self._history.drive()
        predicted = {name: each.over(drive) for name, each in self._predictions.items()}
        if LAST_VALUE in self._names:
            predicted[LAST_VALUE] = self._last_values(drive).over(drive)
        return Run(
            drive=drive,
            predicted=predicted,
            moments=sum(kind is PowerKind.SMOOTHED for kind, _, _ in self._moments),
            stream_s=self._stream_s,
            method_s={name: each.seconds for name, each in self._predictions.items()},
        )

    def _handle(self, event: StreamEvent, now_ns: int) -> None:
        match event:
            case SmoothedSample():
                kind = PowerKind.SMOOTHED
            case NewestSample():
                kind = PowerKind.PREDICTED
            case MeasuredSample():
                if gate(event.sample, event.power) is None:
                    for name, method in self._peers.items():
                        begin = self._clock()
                        method.observe(event.sample, event.power)
                        self._predictions[name].seconds += self._clock() - begin
                return
            case _:
                return  # a gap: the peers see in the next stamp that time passed
        stamp_ns = event.sample.stamp_ns
        self._moments.append((kind, stamp_ns, (now_ns - stamp_ns) / NANOSECONDS))
        for name, method in self._peers.items():
            begin = self._clock()
            power, sigma, *_ = method.predict(event.sample)
            self._predictions[name].seconds += self._clock() - begin
            self._add(name, PowerEstimate(kind, stamp_ns, power, sigma), now_ns)

    def _add(self, name: str, estimate: PowerEstimate, now_ns: int) -> None:
        stamp_ns = estimate.stamp_ns
        self._predictions[name].add(
            estimate.kind,
            stamp_ns,
            self._history.seconds(stamp_ns),
            estimate.power,
            estimate.sigma,
            (now_ns - stamp_ns) / NANOSECONDS,
        )

    def _last_values(self, drive: Drive) -> Predictions:
        """The last battery power measured strictly before each moment, held.

        Taken from the readings themselves, which are newer than what the stream has joined: the
        strongest form of this baseline.
        """
        held = Predictions()
        times = [self._history.seconds(stamp_ns) for _, stamp_ns, _ in self._moments]
        before = np.searchsorted(drive.measured[:, 0], times) - 1
        for (kind, stamp_ns, lag), time, index in zip(self._moments, times, before, strict=True):
            if index >= 0:
                power = float(drive.measured[index, 1])
                held.add(kind, stamp_ns, time, power, math.nan, lag)
        return held
