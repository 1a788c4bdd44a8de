"""Errors of the published parameters on simulated cars, whose truth is known.

Readings of a simulated drive go through the stream and the learning of the car, as in the
estimator of `mode: hybrid`, without its network and power, which do not change the parameters: an
hour of driving takes seconds.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
import math
from typing import Any

import numpy as np

from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.estimate import ParameterSet
from evpinn_ros.core.estimation.parameter_set import identifiable_shares, parameter_set
from evpinn_ros.core.estimation.published import Published, published
from evpinn_ros.core.estimation.terms import Equation
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading
from evpinn_ros.core.signals.reorder import ReorderBuffer
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.core.vehicle.identifiable import IDENTIFIABLE_NAMES
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.replays.simulation.car import Trace
from evpinn_ros.replays.simulation.drive import SAMPLE_RATE, DriveKind, IntervalMotion
from evpinn_ros.replays.simulation.simulate import RMS_GRADE, SimulatedDrive, simulate
from evpinn_ros.replays.simulation.truth import Truth, prior_parameters, true_values

PROFILE = "tesla_model_3"  # of the bus of every car: it has speed, battery and motor torque
VEHICLES = ("tesla_model_3_lr", "nissan_leaf", "bmw_i3")
MARKS = (60, 120, 300, 600)  # s of the drive at which estimates are compared with the truth
INTERVAL = 1.96  # sigmas to either side that cover 95 %


class CarChain:
    """Learns a car from readings, without networks and predictions.

    Attributes:
        car: what is learned.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.car = LearnedCar.new(Equation(vehicle))
        self._stream = SampleStream(StreamSettings(), vehicle.air_density, vehicle.motor_ratio)
        self._buffer = ReorderBuffer(StreamSettings().allowed_lateness)
        self._newest_ns = 0

    def add_readings(self, readings: Iterable[Reading]) -> None:
        """Take readings."""
        block, _ = self._buffer.add(Block.of(readings))
        for _, interval in self._stream.add(block).intervals:
            self.take(interval)

    def take(self, interval: Interval) -> None:
        """Learn from an interval."""
        self.car = self.car.after([interval])
        self._newest_ns = interval.end_ns

    def parameters(self) -> ParameterSet:
        """Present estimate."""
        return parameter_set(self._newest_ns, self.published())

    def published(self) -> Published:
        """Published parameters."""
        return published(self.car.state, self.car.equation, self.car.driven)


def simulated_drives(
    kinds: Sequence[DriveKind],
    vehicles: Sequence[str],
    seeds: Iterable[int],
    seconds: float,
    *,
    from_priors: bool = False,
    **options: Any,
) -> Iterator[SimulatedDrive]:
    """A drive for each seed, each of another car; vehicles and kinds take turns.

    `from_priors` draws the cars from the priors instead of from plausible cars; `options` are
    those of `simulate`.
    """
    for number, seed in enumerate(seeds):
        vehicle = load_vehicle(vehicles[number % len(vehicles)])
        kind = kinds[number // len(vehicles) % len(kinds)]
        wish = prior_parameters(vehicle, np.random.default_rng(seed)) if from_priors else None
        car = wish._asdict() if wish else None
        yield simulate(kind, vehicle, seconds, seed, car=car, can_profile=PROFILE, **options)


@dataclass(frozen=True, slots=True)
class TruthCheck:
    """One quantity of one drive at one time against its truth."""

    vehicle: str
    seed: int
    seconds: int
    name: str
    value: float
    std: float
    prior_share: float
    truth: float

    @property
    def error_percent(self) -> float:
        """Error in percent of the truth."""
        return 100.0 * (self.value / self.truth - 1.0)

    @property
    def covered(self) -> bool:
        """True if the interval of 95 % holds the truth.

        What is learned as a logarithm has its interval there: all but C_rr and p_aux.
        """
        if self.name in ("p_aux", "c_rr"):
            return abs(self.value - self.truth) <= INTERVAL * self.std
        if self.truth <= 0.0:  # less came back than the losses took; it has no logarithm
            return False
        return abs(math.log(self.value / self.truth)) <= INTERVAL * self.std / self.value


@dataclass(frozen=True, slots=True)
class TruthSummary:
    """Comparisons of one quantity at one time over many drives."""

    name: str
    seconds: int
    drives: int
    bias_percent: float
    median_percent: float
    p90_percent: float
    std_percent: float
    coverage_percent: float
    prior_share: float


def compare(
    kind: DriveKind,
    vehicles: Sequence[str],
    seeds: Iterable[int],
    *,
    marks: Sequence[int] = MARKS,
    from_priors: bool = False,
    rms_grade: float = RMS_GRADE,
    altitude: bool = False,
) -> Iterator[TruthCheck]:
    """Drive one car per seed and compare the published parameters with the truth so far.

    `marks` are s into the drive; `altitude` gives the cars a barometer.
    """
    road: dict[str, Any] = {"altitude": altitude, "rms_grade": rms_grade}
    drives = simulated_drives([kind], vehicles, seeds, max(marks), from_priors=from_priors, **road)
    for drive in drives:
        chain, left = CarChain(drive.vehicle), sorted(marks)
        begin = drive.readings[0].stamp_ns
        stamps = [reading.stamp_ns - begin for reading in drive.readings]
        first = 0
        for mark in left:
            last = bisect_left(stamps, (mark - 1) * NANOSECONDS, first)
            chain.add_readings(drive.readings[first:last])
            if last < len(stamps):
                yield from _compared(chain, drive, mark)
            first = last


def summaries(checks: Iterable[TruthCheck]) -> list[TruthSummary]:
    """Median, 90th percentile and coverage of each quantity at each time."""
    groups: dict[tuple[int, str], list[TruthCheck]] = {}
    for check in checks:
        groups.setdefault((check.seconds, check.name), []).append(check)
    return [_summary(group) for group in groups.values()]


def _compared(chain: CarChain, drive: SimulatedDrive, seconds: int) -> Iterator[TruthCheck]:
    estimates = chain.parameters()
    truth = true_so_far(drive, seconds, chain.car.equation)
    share = identifiable_shares(chain.published())

    def check(name: str, value: float, std: float, prior: float, true: float) -> TruthCheck:
        return TruthCheck(drive.vehicle.key, drive.seed, seconds, name, value, std, prior, true)

    for name in IDENTIFIABLE_NAMES[:4]:
        parts = (estimates.identifiable, estimates.identifiable_std, share, truth.identifiable)
        yield check(name, *(getattr(part, name) for part in parts))
    for name in PARAMETER_NAMES:
        estimate, true = estimates.parameters[name], getattr(truth.parameters, name)
        if name not in IDENTIFIABLE_NAMES or name == "p_aux":
            yield check(name, estimate.value, estimate.std, estimate.prior_share, true)


def true_so_far(drive: SimulatedDrive, seconds: int, equation: Equation) -> Truth:
    """The true parameters of the first seconds of a drive."""
    count = seconds * SAMPLE_RATE
    trace = drive.trace
    motion = IntervalMotion(
        **{f.name: getattr(trace.motion, f.name)[:count] for f in fields(IntervalMotion)}
    )
    columns = {f.name: getattr(trace, f.name)[:count] for f in fields(Trace) if f.name != "motion"}
    return true_values(drive.car, Trace(motion=motion, **columns), equation)


def _summary(group: list[TruthCheck]) -> TruthSummary:
    error = np.array([check.error_percent for check in group])
    first = group[0]
    return TruthSummary(
        first.name,
        first.seconds,
        len(group),
        float(error.mean()),
        float(np.median(np.abs(error))),
        float(np.quantile(np.abs(error), 0.9)),
        float(np.median([100 * check.std / check.truth for check in group])),
        float(np.mean([100.0 * check.covered for check in group])),
        float(np.median([check.prior_share for check in group])),
    )
