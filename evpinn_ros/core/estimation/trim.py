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
from typing import Annotated, Any, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.estimation.journey import FORCE_NOISE, POWER_NOISE
from evpinn_ros.core.signals.kinematics import PROFILE
from evpinn_ros.core.signals.sample import Samples

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


class Outputs(NamedTuple):
    """The trim at n rows.

    Attributes:
        power: that it adds to the car's by its evidence, W, shape (n,).
        sigma: 1-sigma of that, W, shape (n,).
        force: N, shape (n,).
        variance: of the force, N^2, shape (n,).
        along: covariance of the weights times the gradient of the force, shape (n, weights).
    """

    power: np.ndarray
    sigma: np.ndarray
    force: np.ndarray
    variance: np.ndarray
    along: np.ndarray


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

    def share_after(self, seconds: np.ndarray) -> np.ndarray:
        """Shares of a correction that hold after some s, shape (n,) both."""
        squares = PRIOR_SQUARES + self.squares
        share = (PRIOR_SQUARES * PRIOR_SHARE + self.products) / squares
        delay = (PRIOR_SQUARES * AHEAD + self.delays) / squares
        return np.asarray(min(max(share, LEAST_PERSISTENCE), 1.0) ** (seconds / delay))


class Trim:
    """One trim, beside one whose output is zero.

    What the weights hold is gone by the next start, so it is not saved. It is kept as when last
    learned, and fades by the seconds since: so all rows up to the next one that is learned from
    are computed together.

    Attributes:
        evidence: logarithm of the odds against no trim.
        persistence: how soon a correction stops being so.
        age: s since it last learned.
    """

    def __init__(self, seed: int = 0) -> None:
        """Start at the prior, with random input weights."""
        rng = np.random.default_rng(seed)
        inner = rng.normal(0.0, 1.0, (UNITS, INPUTS)) * SPREAD
        self._start = np.column_stack((inner, rng.normal(0.0, 1.0, UNITS))).T
        # Weights of a unit's inputs and its bias, of all units, then the outer ones and a force.
        self._prior = np.full(INNER + UNITS + 1, WEIGHT_STD**2)
        self._prior[INNER:] = [TRIM_FORCE**2 / UNITS] * UNITS + [TRIM_FORCE**2]
        self._away = np.zeros(len(self._prior))  # of the weights from where they start
        # The covariance is `_scale` times `_shape`: to let all of it fade costs one product.
        self._shape, self._scale = np.diag(self._prior), 1.0
        self._buffer = np.empty_like(self._shape)
        self.evidence, self.persistence, self.age = 0.0, Persistence(), 0.0
        # Weights at a moment and the s since, to be compared with what comes.
        self._snapshot: tuple[np.ndarray, float] | None = None

    @property
    def share(self) -> float:
        """Probability that the trim explains more than none."""
        return 1.0 / (1.0 + math.exp(-min(max(self.evidence, -MOST_ODDS), MOST_ODDS)))

    def rows_of(self, samples: Samples) -> np.ndarray:
        """What the trim takes of samples, shape (n, columns).

        Inputs of the units, the last for their bias; what the units make of them with their first
        weights; and speed, m/s.
        """
        speed, acceleration = samples.speed[:, None], samples.acceleration[:, None]
        columns = speed, acceleration, samples.profile, np.ones((samples.size, 1))
        inputs = (np.concatenate(columns, axis=1) - INPUT_CENTRE) / INPUT_SCALE
        return np.concatenate((inputs, inputs @ self._start, np.abs(speed)), axis=1)

    def outputs(self, rows: np.ndarray, ages: np.ndarray) -> Outputs:
        """The trim at n of `rows_of`, each some s after it last learned, shape (n,)."""
        keep = np.exp(ages / -TRIM_SECONDS)[:, None]
        hidden, force = _network(self._away, rows, keep)
        gradient = np.ones((len(rows), len(self._prior)))
        slope = keep * self._away[INNER:-1] * (1.0 - hidden * hidden)
        inner = gradient[:, :INNER].reshape(len(rows), UNITS, INPUTS + 1)  # a view
        np.multiply(slope[:, :, None], rows[:, None, : INPUTS + 1], out=inner)
        gradient[:, INNER:-1] = hidden
        left = keep * keep
        along = (left * self._scale) * gradient.dot(self._shape)
        along += (1.0 - left) * self._prior * gradient
        variance = (gradient * along).sum(axis=1)
        reach = self.share * rows[:, -1]
        power = reach * force * self.persistence.share_after(ages)
        return Outputs(power, reach * np.sqrt(np.maximum(variance, 0.0)), force, variance, along)

    def advance(self, duration: float) -> None:
        """Let s pass: weights return to the prior."""
        self.age += duration
        if self._snapshot is not None:
            away, age = self._snapshot
            self._snapshot = away, age + duration

    def learn(self, row: np.ndarray, outputs: Outputs, residual: float, duration: float) -> None:
        """Learn what the car leaves of power at a sample that moves.

        Args:
            row: of `rows_of`.
            outputs: the last of them is at this row and age.
            residual: measured power less that of the car, W.
            duration: that the sample stands for, s.
        """
        v = float(row[-1])
        self._compare(row, residual / v)
        force, variance = float(outputs.force[-1]), float(outputs.variance[-1])
        along = outputs.along[-1]
        error = residual - v * force
        noise = POWER_NOISE**2 + (FORCE_NOISE * v) ** 2
        blunt = 0.5 / (noise * TEMPERATURE)
        with_it, without = min(blunt * error**2, MOST_LOSS), min(blunt * residual**2, MOST_LOSS)
        evidence = self.evidence * math.exp(-duration / EVIDENCE_TIME)
        self.evidence = evidence + duration * (without - with_it)
        of_power = v**2 * variance + noise * CORRELATED
        beyond = max(1.0, abs(error) / (OUTLIER * math.sqrt(of_power)))
        self._fade()
        gain = (v / (of_power * beyond**2)) * along
        self._away = self._away + error * gain
        np.dot(gain[:, None], (v / self._scale) * along[None], out=self._buffer)
        self._shape -= self._buffer
        self._snapshot = self._snapshot or (self._away, 0.0)

    def _fade(self) -> None:
        """Let the weights be what they are at this age, from where they fade anew."""
        keep, self.age = math.exp(-self.age / TRIM_SECONDS), 0.0
        self._away = keep * self._away
        self._scale *= keep**2
        if self._scale < LEAST_SCALE:
            self._shape *= self._scale
            self._scale = 1.0
        diagonal = self._shape.reshape(-1)[:: len(self._prior) + 1]
        diagonal += (1.0 - keep**2) / self._scale * self._prior

    def _compare(self, row: np.ndarray, force: float) -> None:
        """Compare the force that is measured, N, with what the trim gave `AHEAD` before."""
        if self._snapshot is None or self._snapshot[1] < AHEAD:
            return
        (away, age), self._snapshot = self._snapshot, None
        if age < TRIM_SECONDS:
            given = _network(away, row[None], math.exp(-age / TRIM_SECONDS))[1]
            self.persistence.learn(float(given[0]), force, age)


def _network(away: np.ndarray, rows: np.ndarray, keep: Any) -> tuple[np.ndarray, np.ndarray]:
    """Outputs of the units, shape (n, UNITS), and their force, N, shape (n,).

    Args:
        away: of the weights from where they start.
        rows: n of `Trim.rows_of`.
        keep: share of `away` that is left, shape (n, 1) or one for all.
    """
    inner = away[:INNER].reshape(UNITS, INPUTS + 1)
    hidden = np.tanh(rows[:, INPUTS + 1 : -1] + keep * rows[:, : INPUTS + 1].dot(inner.T))
    return hidden, (keep * (hidden.dot(away[INNER:-1, None]) + away[-1]))[:, 0]
