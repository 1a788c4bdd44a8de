"""The posterior of a car: physics and network in one Gaussian, for each hypothesis of a bank.

A `CarState` is a value that never changes, so a copy is a reference: predictions without the
battery go on from one. The functions are pure:

- `advance` lets time pass: the wandering load decays (Ornstein and Uhlenbeck);
- `update` learns from a measured energy (a Kalman filter's update);
- `learn` does both, for an interval and what the bus reported in it.

The model is linear, so successive updates give the same estimate as one solve over a window of
intervals with older data as its arrival cost. The hypotheses of the bank differ in the sizes of
network and wandering load, which are not known beforehand, and are weighted by their evidence.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
import math
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.estimation import gaussian
from evpinn_ros.core.estimation.bands import Bands
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.gaussian import (
    MOST,
    Gaussian,
    Innovation,
    at_least_zero,
    replace_states,
)
from evpinn_ros.core.estimation.journey import (
    Journey,
    journey_of,
    speed_squared,
    unexplained,
    unseen_of,
    wandered,
)
from evpinn_ros.core.estimation.states import LASTING, NAMES, OFFSETS, SIZE, WEIGHTS, State
from evpinn_ros.core.estimation.terms import HEATING, Equation, Warmth, Wheels
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.power import BRIDGE_SHARE, TIMING
from evpinn_ros.core.signals.readings import TEMPERATURES
from evpinn_ros.core.vehicle.physics import GRAVITY

# The hypotheses: 1-sigma of a weight of the network, N, and of the wandering load, W.
NETWORK_STDS, LOAD_STDS = (20.0, 150.0), (30.0, 150.0)
BANK = np.array(list(product(NETWORK_STDS, LOAD_STDS)))
LARGE_NETWORK_ODDS = 7.0  # initial log odds against a large network, which errs in first drives
EVIDENCE_KEPT = 400.0  # intervals over which the hypotheses are judged

SCALE_INTERVALS = 30.0  # over which a scale of the noise is learned
LEAST_SCALE, MOST_SCALE = 0.05, 2000.0
OUTLIER = 2.5  # sigmas
SPARSE = 2.0  # s between speeds from which on driving between them is unknown

DRIFT = 0.02  # share of its prior sigma by which a state of the car changes between drives
# Share of an offset that the next drive keeps: season and roof box last, people change.
DRIVE_KEPT = {State.ROLLING_DRIVE: 0.9, State.MASS_DRIVE: 0.0, State.LOAD_DRIVE: 0.9}
LOSS_SHOWN = 100.0  # s of a drive after which 1/e of the variance of `LOSS_DRIVE` is left
PRIOR_DRIVES, DRIVES_KEPT = 4.0, 30.0  # drives that an offset's prior counts as; most drives
MOST_EVIDENCE = 1e15
Seconds: TypeAlias = Annotated[float, Range(0.0, 1e9)]
Celsius: TypeAlias = Annotated[float, Range(*TEMPERATURES)]
BRAKING_SHARE = 0.2  # of braking energy that friction may take unseen by the motor, 1-sigma


@dataclass(frozen=True, slots=True, eq=False)
class CarState:
    """Knowledge of a car, by K hypotheses.

    Attributes:
        mean: shape (K, SIZE).
        covariance: shape (K, SIZE, SIZE).
        evidence: logarithm of the odds of each hypothesis, shape (K,).
        scale: of the noise, by its kinds, shape (K, 3).
        offset_variance: of `OFFSETS` from drive to drive, shape (len(OFFSETS),).
        bands: scales of predicted energies by rehearsals.
        drives: number of drives that `offset_variance` rests on.
        intervals: number learned from in this drive.
        seconds: length of this drive, s.
        celsius: last known temperature outside, degrees Celsius, or None.
        known: whether a drive before this one was learned from.
        last_drive: length of the drive before, s; 0 if unknown.
        names: of the states.
    """

    mean: Annotated[np.ndarray, Range(-(MOST**2), MOST**2, shape=(len(BANK), SIZE), by_state=True)]
    covariance: Annotated[
        np.ndarray, Range(-(MOST**2), MOST**2, shape=(len(BANK), SIZE, SIZE), by_state=True)
    ]
    evidence: Annotated[np.ndarray, Range(-MOST_EVIDENCE, 0.0, shape=(len(BANK),))]
    scale: Annotated[np.ndarray, Range(LEAST_SCALE, MOST_SCALE, shape=(len(BANK), 3))]
    offset_variance: Annotated[
        np.ndarray, Range(-(MOST**2), MOST**2, shape=(len(OFFSETS),), by_state=True)
    ]
    bands: Bands = field(default_factory=Bands)
    drives: Annotated[float, Range(PRIOR_DRIVES, DRIVES_KEPT)] = PRIOR_DRIVES
    intervals: Annotated[int, Range(0, 10**12)] = 0
    seconds: Seconds = 0.0
    celsius: Celsius | None = None
    known: bool = False
    last_drive: Seconds = 0.0
    names: tuple[str, ...] = NAMES

    @property
    def gaussian(self) -> Gaussian:
        """Mean and covariance of all hypotheses."""
        return Gaussian(self.mean, self.covariance)

    @property
    def weights(self) -> np.ndarray:
        """Probability of each hypothesis, shape (K,)."""
        weights = np.exp(self.evidence - self.evidence.max())
        return np.asarray(weights / weights.sum())

    def mixture(self) -> Gaussian:
        """Mean, shape (SIZE,), and covariance over all hypotheses."""
        return gaussian.mixture(self.weights, self.gaussian)

    @property
    def load_variance(self) -> np.ndarray:
        """Variance of the wandering load of each hypothesis, W^2, shape (K,)."""
        return np.asarray(BANK[:, 1] ** 2)

    def model(self, equation: Equation) -> CarModel:
        """The car for predictions from here on."""
        whole = self.mixture()
        mean, covariance = at_least_zero(whole, HEATING), whole.covariance
        covariance[State.LOSS_DRIVE, State.LOSS_DRIVE] *= math.exp(-self.seconds / LOSS_SHOWN)
        return CarModel(
            equation=equation,
            mean=mean,
            covariance=covariance,
            noise=self.weights @ self.scale,
            load_variance=float(self.weights @ self.load_variance),
            growth=self.bands.growth,
            trust=self._trust(),
            seconds=self.seconds,
            celsius=self.celsius,
            last_drive=self.last_drive,
            record=self.bands.record,
        )

    def _trust(self) -> float:
        """Factor of the variance of energy; 1 before any drive: the prior is wide."""
        if self.intervals:
            return self.bands.dropout.scale
        return self.bands.drive.scale if self.known else 1.0

    def with_gaussian(self, now: Gaussian, **others: Any) -> CarState:
        """The state with another mean and covariance, and with these fields replaced."""
        return replace(self, mean=now.mean, covariance=now.covariance, **others)

    def forgetting(self, variances: Mapping[State, Any]) -> CarState:
        """The state with some entries set to zero, uncorrelated, with these variances."""
        return self.with_gaussian(replace_states(self.gaussian, variances))


class Residual(NamedTuple):
    """Innovation of one interval: measured less predicted, J, and its 1-sigma, J."""

    residual: float
    sigma: float


class IntervalTerms(NamedTuple):
    """Terms of an interval by the equation of a car.

    Attributes:
        interval: of n steps.
        wheels: work of the prior car in the steps.
        rows: energy of the steps by state, J per unit, shape (n, SIZE).
        journey: their sum.
        warmth: of tyres and cabin.
    """

    interval: Interval
    wheels: Wheels
    rows: np.ndarray
    journey: Journey
    warmth: Warmth


def initial_state(equation: Equation) -> CarState:
    """State of a car before its first drive."""
    count = len(BANK)
    mean = np.repeat(equation.mean[None], count, axis=0)
    covariance = np.repeat(equation.covariance[None], count, axis=0)
    weights = np.arange(SIZE)[WEIGHTS]
    covariance[:, weights, weights] = BANK[:, :1] ** 2
    covariance[:, State.LOAD, State.LOAD] = BANK[:, 1] ** 2
    return CarState(
        mean=mean,
        covariance=covariance,
        evidence=np.where(BANK[:, 0] == max(NETWORK_STDS), -LARGE_NETWORK_ODDS, 0.0),
        scale=np.ones((count, 3)),
        offset_variance=equation.covariance[OFFSETS, OFFSETS].copy(),
    )


def interval_terms(equation: Equation, interval: Interval, seconds: float) -> IntervalTerms:
    """The terms of an interval that begins `seconds` after the start of a drive."""
    warmth = Warmth.after(seconds)
    wheels = equation.of_steps(interval.steps, interval.conditions)
    rows = equation.rows(interval.steps, interval.conditions, warmth, wheels)
    return IntervalTerms(interval, wheels, rows, journey_of(interval, rows.sum(0)), warmth)


def learn(state: CarState, equation: Equation, terms: IntervalTerms) -> tuple[CarState, Residual]:
    """The state after an interval whose battery was measured, and its innovation."""
    interval, conditions = terms.interval, terms.interval.conditions
    state = advance(state, interval.duration, unseen_of(interval))
    state = replace(state, celsius=conditions.celsius)
    if interval.steps.motor_known:
        rows = equation.motor_rows(interval.steps, conditions, terms.warmth, terms.wheels)
        state = see_motor(state, rows, speed_squared(interval.steps))
    return update(state, terms.journey, interval.energy, _sampling_variance(state, terms))


def _sampling_variance(state: CarState, terms: IntervalTerms) -> float:
    """Variance of the energy of an interval due to the rate of its readings, J^2.

    In a log with seconds between its rows it follows from predicted power. By measured power, an
    interval that missed a burst of power would be trusted, and one that caught it doubted.
    """
    duration = terms.interval.steps.duration
    step = float(np.median(duration))
    if step < SPARSE:
        return terms.interval.sampling_variance
    power = terms.rows @ (state.weights @ state.mean) / duration
    apart = (duration[1:] + duration[:-1]) / 2.0
    bridge = BRIDGE_SHARE * float(np.diff(power) ** 2 @ apart**2)
    return bridge + (TIMING * step) ** 2 * float(power[0] ** 2 + power[-1] ** 2)


def advance(state: CarState, seconds: float, unseen: float = 0.0) -> CarState:
    """Let time, s, and road without height, m, pass; fast energies restart with this journey."""
    left, integral, rest = wandered(seconds)
    load, energy, climb = State.LOAD, State.LOAD_ENERGY, State.CLIMB
    mean, covariance = state.mean.copy(), state.covariance.copy()
    # Only these rows and columns change: a transition matrix would be mostly identity.
    for rows in (mean.T, covariance.transpose(1, 0, 2), covariance.transpose(2, 0, 1)):
        rows[State.WANDERED] += rows[energy]
        rows[State.CLIMBED] += rows[climb]
        rows[climb] = 0.0
        rows[energy] = integral * rows[load]
        rows[load] *= left
    weight = GRAVITY * state.mean[:, State.MASS_OVER_ETA]
    covariance[:, climb, climb] += weight**2 * state.bands.growth * unseen
    covariance[:, load, load] += state.load_variance * (1.0 - left**2)
    covariance[:, energy, energy] += state.load_variance * rest
    shared = state.load_variance * integral * (1.0 - left)
    covariance[:, load, energy] += shared
    covariance[:, energy, load] += shared
    return state.with_gaussian(Gaussian(mean, covariance), seconds=state.seconds + seconds)


def update(
    state: CarState, journey: Journey, energy: float, sampling: float
) -> tuple[CarState, Residual]:
    """Learn from the energy, J, of a journey that has just passed (`advance` first).

    `sampling` is the variance of the energy due to the rate of its readings, J^2.
    """
    row = journey.row.copy()
    # Where the motor's energy is known, it includes the climb.
    climbs = 0.0 if journey.noise[2] else 1.0
    row[State.LOAD], row[State.LOAD_ENERGY], row[State.CLIMB] = 0.0, 1.0, climbs
    row[State.LOSS_DRIVE] = 0.0  # not separable within a drive; it counts for whole drives
    noise = state.scale * journey.noise
    state, seen = _see(state, row, energy - state.mean @ row, noise.sum(1) + sampling)
    state = _judge(state, seen, noise)
    weights = state.weights
    mean = float(weights @ seen.residual)
    variance = float(weights @ (seen.variance + (seen.residual - mean) ** 2))
    return replace(state, intervals=state.intervals + 1), Residual(mean, math.sqrt(variance))


def see_motor(state: CarState, rows: np.ndarray, square: float) -> CarState:
    """Learn the work of the wheels from the motor's energy, without the battery.

    `rows` are those of `Equation.motor_rows`; `square` is the integral of speed squared, m^2/s.
    """
    base = state.scale[:, 1] * unexplained(0.0, 0.0, square)[1]
    for row, share in zip(rows, (0.03, BRAKING_SHARE), strict=True):
        size = share * np.abs(row[State.MOTOR_DRIVE] - row[State.MOTOR_BRAKE])
        state, _ = _see(state, row, -(state.mean @ row), base + size**2 + 1.0)
    return state


def begin_drive(state: CarState, equation: Equation, *, keep: float = 1.0) -> CarState:
    """The state at the start of another drive: offsets keep a part, the car drifts a little.

    `keep` is the share of `DRIVE_KEPT` that stays of the offsets. Their variance is learned from
    the last drive (expectation maximisation with a prior of `PRIOR_DRIVES` drives).
    """
    if not state.intervals:
        return forget_road(replace(state, seconds=0.0))
    whole = state.mixture()
    squares = whole.mean[OFFSETS] ** 2 + whole.covariance[OFFSETS, OFFSETS]
    variance = (state.drives * state.offset_variance + squares) / (state.drives + 1.0)
    kept, fresh = np.ones(SIZE), np.zeros((len(state.mean), SIZE))
    kept[OFFSETS] = [keep * DRIVE_KEPT[offset] for offset in OFFSETS]
    fresh[:, OFFSETS] = (1.0 - kept[OFFSETS] ** 2) * variance
    prior = np.repeat(np.diag(equation.covariance)[None], len(state.mean), axis=0)
    prior[:, WEIGHTS] = BANK[:, :1] ** 2
    fresh[:, LASTING] = DRIFT**2 * prior[:, LASTING]
    covariance = kept[:, None] * state.covariance * kept + fresh[:, :, None] * np.eye(SIZE)
    state = state.with_gaussian(
        Gaussian(kept * state.mean, covariance),
        offset_variance=variance,
        drives=min(state.drives + 1.0, DRIVES_KEPT),
        intervals=0,
        seconds=0.0,
        known=True,
        last_drive=state.seconds,
    )
    return forget_road(state.forgetting({State.WANDERED: 0.0, State.CLIMBED: 0.0}))


def forget_road(state: CarState) -> CarState:
    """The state after a jump of time: the wandering load is unknown again."""
    return forget_present(state.forgetting({State.LOAD: state.load_variance}))


def forget_present(state: CarState) -> CarState:
    """Leave fast energies of a dropout out of the sums of the drive."""
    return state.forgetting({State.LOAD_ENERGY: 0.0, State.CLIMB: 0.0})


def _see(
    state: CarState, row: np.ndarray, residual: np.ndarray, noise: np.ndarray
) -> tuple[CarState, Innovation]:
    """Condition every hypothesis on one measurement; outliers count less (heavy tail)."""
    seen = gaussian.innovate(state.gaussian, row, residual, noise)
    extra = gaussian.outlier_variance(seen, noise, OUTLIER)
    return state.with_gaussian(gaussian.condition(state.gaussian, seen, extra)), seen


def _judge(state: CarState, seen: Innovation, noise: np.ndarray) -> CarState:
    """Update the evidence of the hypotheses, and the scale of the dominant kind of noise."""
    square = seen.residual**2 / seen.variance
    likelihood = -0.5 * (np.minimum(square, 2 * OUTLIER**2) + np.log(seen.variance))
    evidence = state.evidence * (1.0 - 1.0 / EVIDENCE_KEPT) + likelihood
    growth = (np.minimum(square, OUTLIER**2) - 1.0) / SCALE_INTERVALS
    counts = noise == noise.max(1, keepdims=True)
    scale = state.scale * np.exp(growth[:, None] * counts)
    return replace(
        state,
        evidence=evidence - evidence.max(),
        scale=np.clip(scale, LEAST_SCALE, MOST_SCALE),
    )
