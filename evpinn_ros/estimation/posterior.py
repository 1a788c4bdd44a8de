"""The posterior of a car: physics and network in one Gaussian, for each hypothesis of a bank.

A `CarState` is a value: nothing in it is changed, so a copy is a reference, and what predicts
without the battery or tries another mass simply goes on from one. The functions are pure:

- `advance` lets time pass: the wandering load forgets itself (Ornstein and Uhlenbeck);
- `predict` gives the energy of a journey, and its variance, from here on;
- `condition` learns from a measured energy (a Kalman filter's update).

All is linear, so one update after another is the same estimate as one solve over a window of
intervals with what is older as its arrival cost. The hypotheses of the bank differ in the sizes
of network and wandering load, which no car knows beforehand, and are weighted by their evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product
import math

import numpy as np

from evpinn_ros.estimation.bands import Bands
from evpinn_ros.estimation.car_model import CarModel
from evpinn_ros.estimation.gaussian import (
    Gaussian,
    Innovation,
    innovate,
    mixture,
    outlier_variance,
    replace_states,
)
from evpinn_ros.estimation.gaussian import condition as conditioned
from evpinn_ros.estimation.gaussian import predict as passed
from evpinn_ros.estimation.journey import Journey, Learned
from evpinn_ros.estimation.noise import unexplained, wandered
from evpinn_ros.estimation.states import LASTING, OFFSETS, SIZE, WEIGHTS, State
from evpinn_ros.estimation.terms import Equation, Warmth
from evpinn_ros.vehicle.physics import GRAVITY

# The hypotheses: 1-sigma of a weight of the network, N, and of the wandering load, W.
NETWORK_STDS, LOAD_STDS = (20.0, 150.0), (30.0, 150.0)
BANK = np.array(list(product(NETWORK_STDS, LOAD_STDS)))
LARGE_NETWORK_ODDS = 7.0  # of logarithm, against a large network at first: first drives are wild
EVIDENCE_KEPT = 400.0  # intervals over which the hypotheses are judged

SCALE_INTERVALS = 30.0  # over which a scale of the noise is learned
LEAST_SCALE, MOST_SCALE = 0.05, 2000.0
OUTLIER = 2.5  # sigmas

DRIFT = 0.02  # of its prior sigma, by which a state of the car changes from drive to drive
DRIVE_KEPT = 0.9  # of an offset of a drive that the next still has: the season, a roof box
PRIOR_DRIVES, DRIVES_KEPT = 4.0, 30.0  # that the prior of an offset counts as, and at most
CLIMATE_NOISE, CLIMATE_TIME = 500.0, 600.0  # W and s: reported heating about its mean
BRAKING_SHARE = 0.2  # of braking energy that friction may take unseen by the motor, 1-sigma


@dataclass(frozen=True, slots=True, eq=False)
class CarState:
    """Knowledge of a car; see the module's text. K hypotheses.

    Attributes:
        mean: shape (K, SIZE).
        covariance: shape (K, SIZE, SIZE).
        evidence: logarithm of the odds of each hypothesis, shape (K,).
        scale: of the noise, by its kinds, shape (K, 3).
        offset_variance: of `OFFSETS` from drive to drive, shape (len(OFFSETS),).
        bands: how far predicted energies are to be trusted.
        drives: how many `offset_variance` rests on.
        intervals: learned from in this drive.
        seconds: of this drive.
        reports: whether the car reports its heating.
        celsius: temperature outside, the last known, or None.
        known: whether a drive was learned from before this one.
        last_drive: s of the drive before.
    """

    mean: np.ndarray
    covariance: np.ndarray
    evidence: np.ndarray
    scale: np.ndarray
    offset_variance: np.ndarray
    bands: Bands = field(default_factory=Bands)
    drives: float = PRIOR_DRIVES
    intervals: int = 0
    seconds: float = 0.0
    reports: bool = False
    celsius: float | None = None
    known: bool = False
    last_drive: float = 0.0

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
        return mixture(self.weights, self.gaussian)

    @property
    def warmth(self) -> Warmth:
        """Coldness of tyres and cabin now."""
        return Warmth.after(self.seconds)

    @property
    def load_variance(self) -> np.ndarray:
        """Variance of the wandering load of each hypothesis, W^2, shape (K,)."""
        return np.asarray(BANK[:, 1] ** 2)

    def model(self, equation: Equation) -> CarModel:
        """The car as predictions from here on take it."""
        mean, covariance = self.mixture()
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
            reports=self.reports,
            last_drive=self.last_drive,
        )

    def _trust(self) -> float:
        """Factor of the variance of energy; of a car never driven the prior is wide as it is."""
        if self.intervals:
            return self.bands.dropout.scale
        return self.bands.drive.scale if self.known else 1.0

    def with_gaussian(self, now: Gaussian) -> CarState:
        """With another mean and covariance."""
        return replace(self, mean=now.mean, covariance=now.covariance)


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


def advance(state: CarState, seconds: float, unseen: float = 0.0) -> CarState:
    """Let time and road pass: what is fast goes on, its energies are those of this journey.

    Args:
        state: before it.
        seconds: s.
        unseen: m of road whose height is not known.
    """
    left, integral, rest = wandered(seconds)
    transition, noise = np.eye(SIZE), np.zeros((len(state.mean), SIZE, SIZE))
    load, energy, climb = State.LOAD, State.LOAD_ENERGY, State.CLIMB
    for present, before in ((energy, State.WANDERED), (climb, State.CLIMBED)):
        transition[before, present] = 1.0
        transition[present, present] = 0.0
    weight = GRAVITY * state.mean[:, State.MASS]
    noise[:, climb, climb] = weight**2 * state.bands.growth * unseen
    transition[energy, load], transition[load, load] = integral, left
    noise[:, load, load] = state.load_variance * (1.0 - left**2)
    noise[:, energy, energy] = state.load_variance * rest
    noise[:, load, energy] = noise[:, energy, load] = state.load_variance * integral * (1.0 - left)
    now = passed(state.gaussian, transition, noise)
    return replace(
        state, mean=now.mean, covariance=now.covariance, seconds=state.seconds + seconds
    )


def condition(
    state: CarState, journey: Journey, energy: float, sampling: float
) -> tuple[CarState, Learned]:
    """Learn from the energy of a journey that has just passed (`advance` first).

    Args:
        state: before it.
        journey: what was driven.
        energy: measured, J.
        sampling: variance of that, due to the rate of its readings, J^2.
    """
    row = journey.row.copy()
    # The motor's energy holds the climb already, where it is known.
    climbs = 0.0 if journey.noise[2] else 1.0
    row[State.LOAD], row[State.LOAD_ENERGY], row[State.CLIMB] = 0.0, 1.0, climbs
    own = state.scale * journey.noise
    noise = own.sum(1) + sampling
    state, seen = _see(state, row, energy - state.mean @ row, noise)
    state = _judge(state, seen, own)
    weights = state.weights
    mean = float(weights @ seen.residual)
    variance = float(weights @ (seen.variance + (seen.residual - mean) ** 2))
    return replace(state, intervals=state.intervals + 1), Learned(mean, math.sqrt(variance))


def see_motor(state: CarState, rows: np.ndarray, square: float) -> CarState:
    """Learn from the motor's energy what the wheels take, whatever the battery gave.

    Args:
        state: before it.
        rows: of `Equation.motor_rows`, shape (2, SIZE).
        square: integral of speed squared, m^2/s.
    """
    base = state.scale[:, 1] * unexplained(0.0, 0.0, square)[1]
    for row, share in zip(rows, (0.03, BRAKING_SHARE), strict=True):
        size = share * np.abs(row[State.MOTOR_DRIVE] - row[State.MOTOR_BRAKE])
        state, _ = _see(state, row, -(state.mean @ row), base + size**2 + 1.0)
    return state


def see_reported_climate(
    state: CarState, row: np.ndarray, power: float, seconds: float
) -> CarState:
    """Learn from reported heating and cooling, W, how it goes with temperature.

    Args:
        state: before it.
        row: of `terms.climate_row`, W per unit, shape (SIZE,).
        power: reported, W.
        seconds: that it stands for. A drive has few independent ones.
    """
    row = row.copy()
    row[State.CLIMATE_DRIVE] = 1.0
    noise = np.full(len(state.mean), CLIMATE_NOISE**2 * CLIMATE_TIME / seconds)
    return _see(state, row, power - state.mean @ row, noise)[0]


def begin_drive(state: CarState, equation: Equation, *, keep: float = DRIVE_KEPT) -> CarState:
    """Another drive: other offsets, of which some is as it was; the car has drifted a little.

    The variance of the offsets is learned from the drive that was (expectation maximisation with
    a prior of `PRIOR_DRIVES` drives).

    Args:
        state: at the end of a drive.
        equation: of the car.
        keep: share of the offsets that stays.
    """
    variance, drives = state.offset_variance, state.drives
    if not state.intervals:
        return forget_road(replace(state, seconds=0.0))
    whole = state.mixture()
    found = whole.mean[OFFSETS] ** 2 + whole.covariance[OFFSETS, OFFSETS]
    variance = (drives * variance + found) / (drives + 1.0)
    kept, fresh = np.ones(SIZE), np.zeros((len(state.mean), SIZE))
    kept[OFFSETS] = keep
    fresh[:, OFFSETS] = (1.0 - keep**2) * variance
    prior = np.repeat(np.diag(equation.covariance)[None], len(state.mean), axis=0)
    prior[:, WEIGHTS] = BANK[:, :1] ** 2
    fresh[:, LASTING] = DRIFT**2 * prior[:, LASTING]
    now = passed(state.gaussian, np.diag(kept), fresh[:, :, None] * np.eye(SIZE))
    state = replace(
        state,
        mean=now.mean,
        covariance=now.covariance,
        offset_variance=variance,
        drives=min(drives + 1.0, DRIVES_KEPT),
        intervals=0,
        seconds=0.0,
        known=True,
        last_drive=state.seconds,
    )
    now = replace_states(state.gaussian, {State.WANDERED: 0.0, State.CLIMBED: 0.0})
    return forget_road(state.with_gaussian(now))


def forget_road(state: CarState) -> CarState:
    """After a jump of time: the load that wandered is another."""
    fresh = {State.LOAD: state.load_variance}
    return forget_present(state.with_gaussian(replace_states(state.gaussian, fresh)))


def forget_present(state: CarState) -> CarState:
    """Leave fast energies of the last journey out of the sums of the drive: it was a dropout."""
    fresh = {State.LOAD_ENERGY: 0.0, State.CLIMB: 0.0}
    return state.with_gaussian(replace_states(state.gaussian, fresh))


def _see(
    state: CarState, row: np.ndarray, residual: np.ndarray, noise: np.ndarray
) -> tuple[CarState, Innovation]:
    """Condition every hypothesis on one measurement, beyond `OUTLIER` with a heavy tail."""
    rows = np.repeat(row[None], len(state.mean), axis=0)
    seen = innovate(state.gaussian, rows, residual, noise)
    extra = outlier_variance(seen, noise, OUTLIER)
    return state.with_gaussian(conditioned(state.gaussian, seen, extra)), seen


def _judge(state: CarState, seen: Innovation, noise: np.ndarray) -> CarState:
    """Weigh the hypotheses by the evidence, and learn the scale of the noise that counts most."""
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
