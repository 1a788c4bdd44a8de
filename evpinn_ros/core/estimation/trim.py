"""The trim: a network of the last seconds, which corrects power and is forgotten after them.

Battery power is that of the car (`estimation.terms`, physics and network) plus v T(u; w), with T
tanh units of speed, acceleration and its profile. All weights are learned by an extended Kalman
filter at every sample: Gauss-Newton with an arrival cost (Bell and Cathey, 1993). They return to
their prior within `TRIM_SECONDS`: the trim holds what this road, this wind and this second have
beside the car, and is gone soon after a dropout begins. How soon that is, and if the trim counts
at all, is learned (`Persistence`; the evidence of the trim against one of zero).

It is not the network of the car, which lasts and is learned with the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Annotated, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.estimation.journey import FORCE_NOISE, POWER_NOISE
from evpinn_ros.core.signals.kinematics import PROFILE
from evpinn_ros.core.signals.sample import Samples
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED

UNITS = 16
INPUTS = 2 + PROFILE
INNER = UNITS * (INPUTS + 1)  # weights of inputs and biases; those of the units follow
INPUT_CENTRE = np.array([10.0, 0.0, *([0.0] * PROFILE), 0.0])  # m/s, m/s^2; of the bias none
INPUT_SCALE = np.array([15.0, 1.2, *([0.5] * PROFILE), 1.0])
SPREAD = np.array([1.2, 1.2, *([0.7] * PROFILE)])  # 1-sigma of the first input weights
TRIM_FORCE = 1000.0  # N, 1-sigma of the force that the trim may add
TRIM_SECONDS = 10.0  # s of driving in which weights return to the prior
WEIGHT_STD = 0.5  # of input weights about where they start
CORRELATED = 2.0  # samples of 10 Hz that count as one
EVIDENCE_TIME = 300.0  # s of driving over which the trim is judged
TEMPERATURE = 9.0  # by which the evidence of one sample is blunted: heavy tails
MOST_LOSS = 20.0
OUTLIER = 3.0  # sigmas
MOST_ODDS = 30.0  # logarithm; a share nearer to 0 or 1 is rounding
MOST_TRIM_EVIDENCE = 1e6  # no saved one is larger
AHEAD = 1.0  # s after which a correction is compared with what came, or at the next sample
# Before any is compared, half of a correction holds after `AHEAD`: as sure as ten of 100 N say it.
PRIOR_SQUARES, PRIOR_SHARE = 10.0 * 100.0**2, 0.5
LEAST_PERSISTENCE = 0.01  # that holds
MOST_SQUARES = 1e15  # N^2, sum over `EVIDENCE_TIME`
LEAST_SCALE = 1e-30  # of the covariance, before it is taken into its shape


class _Output(NamedTuple):
    """Force of the trim at a sample, N, its variance, N^2, and shape times gradient."""

    force: float
    variance: float
    along: np.ndarray


class Correction(NamedTuple):
    """Power that the trim adds to that of the car, W, and its 1-sigma, W."""

    power: float
    sigma: float


@dataclass(slots=True)
class Persistence:
    """Share of a correction that still holds some seconds later: a regression through zero.

    Wind and road hold for many seconds, noise of speed and battery for less than one.

    Attributes:
        squares: sum of squares of forces that the trim gave, N^2.
        products: sum of their products with the forces measured later.
        delays: sum of their squares times the seconds between, N^2 s.
    """

    squares: Annotated[float, Range(0.0, MOST_SQUARES)] = 0.0
    products: Annotated[float, Range(-MOST_SQUARES, MOST_SQUARES)] = 0.0
    delays: Annotated[float, Range(0.0, MOST_SQUARES)] = 0.0

    def learn(self, given: float, measured: float, delay: float) -> None:
        """Compare a force that the trim gave, N, with the one measured some s later."""
        keep = math.exp(-delay / EVIDENCE_TIME)
        self.squares = keep * self.squares + given**2
        self.products = keep * self.products + given * measured
        self.delays = keep * self.delays + given**2 * delay

    def share_after(self, seconds: float) -> float:
        """Share of a correction that holds after some s."""
        squares = PRIOR_SQUARES + self.squares
        share = (PRIOR_SQUARES * PRIOR_SHARE + self.products) / squares
        delay = (PRIOR_SQUARES * AHEAD + self.delays) / squares
        return float(min(max(share, LEAST_PERSISTENCE), 1.0) ** (seconds / delay))


class Trim:
    """One trim, beside one whose output is zero.

    What the weights hold is gone by the next start, so it is not saved.

    Attributes:
        evidence: logarithm of the odds against no trim.
        persistence: how soon a correction stops being so.
    """

    def __init__(self, seed: int = 0) -> None:
        """Start at the prior, with random input weights."""
        rng = np.random.default_rng(seed)
        inner = rng.normal(0.0, 1.0, (UNITS, INPUTS)) * SPREAD
        # Weights of a unit's inputs and its bias, of all units, then the outer ones and a force.
        inner = np.column_stack((inner, rng.normal(0.0, 1.0, UNITS))).ravel()
        self._start = np.append(inner, np.zeros(UNITS + 1))
        self._prior = np.full(len(self._start), WEIGHT_STD**2)
        self._prior[inner.size :] = [TRIM_FORCE**2 / UNITS] * UNITS + [TRIM_FORCE**2]
        self._away = np.zeros(len(self._prior))  # of the weights from where they start
        self._weights = self._start.copy()
        # The covariance is `_scale` times `_shape`: to let all of it fade costs one product.
        self._shape, self._scale = np.diag(self._prior), 1.0
        self._buffer, self._gradient = np.empty_like(self._shape), np.ones(len(self._prior))
        self.evidence, self.persistence = 0.0, Persistence()
        self._age = 0.0  # s since it last learned
        # Weights at a moment and the s since, to be compared with what comes.
        self._snapshot: tuple[np.ndarray, float] | None = None
        self._newest: tuple[np.ndarray, _Output] | None = None  # at these weights

    @property
    def share(self) -> float:
        """Probability that the trim explains more than none."""
        return 1.0 / (1.0 + math.exp(-min(max(self.evidence, -MOST_ODDS), MOST_ODDS)))

    def correct(self, inputs: np.ndarray, speed: float) -> Correction:
        """Power that the trim adds at a row of `inputs_of` and a speed, m/s, by its evidence."""
        output = self._output(inputs)
        reach = self.share * abs(speed)
        power = reach * output.force * self.persistence.share_after(self._age)
        return Correction(power, reach * math.sqrt(max(0.0, output.variance)))

    def advance(self, duration: float) -> None:
        """Let s pass: weights return to the prior."""
        keep = math.exp(-duration / TRIM_SECONDS)
        self._move(keep * self._away)
        self._age += duration
        if self._snapshot is not None:
            away, age = self._snapshot
            self._snapshot = away, age + duration
        self._scale *= keep**2
        if self._scale < LEAST_SCALE:
            self._shape *= self._scale
            self._scale = 1.0
        diagonal = self._shape.reshape(-1)[:: len(self._prior) + 1]
        diagonal += (1.0 - keep**2) / self._scale * self._prior

    def learn(self, inputs: np.ndarray, speed: float, residual: float, duration: float) -> None:
        """Learn what the car leaves of power, W, at a sample that stands for some s."""
        v = abs(speed)
        if v < STANDSTILL_SPEED:
            return
        self._compare(inputs, residual / v)
        output = self._output(inputs)
        error = residual - v * output.force
        noise = POWER_NOISE**2 + (FORCE_NOISE * v) ** 2
        blunt = 0.5 / (noise * TEMPERATURE)
        with_it, without = min(blunt * error**2, MOST_LOSS), min(blunt * residual**2, MOST_LOSS)
        evidence = self.evidence * math.exp(-duration / EVIDENCE_TIME)
        self.evidence = evidence + duration * (without - with_it)
        variance = v**2 * output.variance + noise * CORRELATED
        beyond = max(1.0, abs(error) / (OUTLIER * math.sqrt(variance)))
        gain = (v * self._scale / (variance * beyond**2)) * output.along
        self._move(self._away + error * gain)
        np.dot(gain[:, None], v * output.along[None], out=self._buffer)
        np.subtract(self._shape, self._buffer, out=self._shape)
        self._age = 0.0
        self._snapshot = self._snapshot or (self._away, 0.0)

    def _compare(self, inputs: np.ndarray, force: float) -> None:
        """Compare the force that is measured, N, with what the trim gave `AHEAD` before."""
        if self._snapshot is None or self._snapshot[1] < AHEAD:
            return
        (away, age), self._snapshot = self._snapshot, None
        if age < TRIM_SECONDS:
            weights = self._start + math.exp(-age / TRIM_SECONDS) * away
            hidden = np.tanh(_inner(weights).dot(inputs))
            self.persistence.learn(_force(weights, hidden), force, age)

    def _move(self, away: np.ndarray) -> None:
        """Let the weights be away from where they start by so much."""
        self._away, self._newest = away, None
        np.add(self._start, away, out=self._weights)

    def _output(self, inputs: np.ndarray) -> _Output:
        """Output at a row; that of the last one is learned from next, at the same weights."""
        if self._newest is not None and self._newest[0] is inputs:
            return self._newest[1]
        weights, gradient = self._weights, self._gradient
        hidden = np.tanh(_inner(weights).dot(inputs))
        slope = weights[INNER:-1] * (1.0 - hidden * hidden)
        np.dot(slope[:, None], inputs[None], out=_inner(gradient))
        gradient[INNER:-1] = hidden
        along = self._shape.dot(gradient)
        variance = self._scale * float(gradient.dot(along))
        output = _Output(_force(weights, hidden), variance, along)
        self._newest = inputs, output
        return output


def _inner(weights: np.ndarray) -> np.ndarray:
    """The weights of each unit's inputs and its bias, shape (UNITS, INPUTS + 1): a view."""
    return weights[:INNER].reshape(UNITS, -1)


def _force(weights: np.ndarray, hidden: np.ndarray) -> float:
    """Output of the network by that of its units, N."""
    return float(weights[INNER:-1].dot(hidden) + weights[-1])


def inputs_of(samples: Samples) -> np.ndarray:
    """Inputs of the units at samples, the last for their bias, shape (n, INPUTS + 1)."""
    columns = samples.speed, samples.acceleration, samples.profile, np.ones(samples.size)
    return np.asarray((np.column_stack(columns) - INPUT_CENTRE) / INPUT_SCALE)
