"""The network of the online PINN: tanh units whose weights are states under a physics prior.

Battery power is P = P_physics(x) + v N(u; w), with N a network of one hidden layer (eq. 1 of the
paper) of speed, acceleration and its profile. All weights are learned by an extended Kalman filter
at every sample: Gauss-Newton with an arrival cost, one step a sample (Bell and Cathey, 1993).

The prior pulls N to zero, so physics explains what it can (lambda of eq. 22 is the noise's
variance over that of the prior). Whether the network counts is learned: it stands beside one that
is zero, and the two are weighted by their evidence.

The prior is also what weights return to, within `MEMORY`: the network holds what this road, this
wind and this place in the map of efficiency have beside the physics. So the last seconds are its
window, the prior its arrival cost, and it is gone soon after a dropout begins. A network
that lasts was measured beside it and makes dropouts worse (docs/project/benchmark_history.md).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.signals.kinematics import PROFILE
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.physics import STANDSTILL_SPEED

UNITS = 16
INPUTS = 2 + PROFILE
INPUT_CENTRE = np.array([10.0, 0.0, *([0.0] * PROFILE)])  # m/s, m/s^2
INPUT_SCALE = np.array([15.0, 1.2, *([0.5] * PROFILE)])
SPREAD = np.array([1.2, 1.2, *([0.7] * PROFILE)])  # 1-sigma of the first input weights
REACH = 1000.0  # N, 1-sigma of the force that the network may add
MEMORY = 10.0  # s of driving in which weights return to the prior
WEIGHT_STD = 0.5  # of input weights about where they start
STANDING_NOISE = 150.0  # W, 1-sigma of a sample's power that nothing explains
FORCE_NOISE = 60.0  # N, the same while moving
CORRELATED = 5.0  # samples of 10 Hz that count as one
EVIDENCE_TIME = 300.0  # s of driving over which the networks are judged
TEMPERATURE = 9.0  # by which the evidence of one sample is blunted: heavy tails
MOST_LOSS = 20.0
OUTLIER = 3.0  # sigmas
MOST_ODDS = 30.0  # logarithm; a share nearer to 0 or 1 is rounding
MOST_EVIDENCE = 1e6  # no saved one is larger


class Correction(NamedTuple):
    """Power that the network adds to that of physics, W, and its 1-sigma, W."""

    power: float
    sigma: float


class ResidualNetwork:
    """One network, beside one whose output is zero.

    Attributes:
        evidence: logarithm of the odds against the zero network; all that is saved, for what the
            weights hold is gone by the next start.
    """

    def __init__(self, seed: int = 0) -> None:
        """Start at the prior, with random input weights."""
        rng = np.random.default_rng(seed)
        inner = rng.normal(0.0, 1.0, (UNITS, INPUTS)) * SPREAD
        self._start = np.concatenate(
            (inner.ravel(), rng.normal(0.0, 1.0, UNITS), np.zeros(UNITS + 1))
        )
        inner_std = np.full(UNITS * (INPUTS + 1), WEIGHT_STD)
        outer_std = np.full(UNITS, REACH / math.sqrt(UNITS))
        self._prior = np.concatenate((inner_std, outer_std, [REACH])) ** 2
        self._weights, self._covariance = self._start.copy(), np.diag(self._prior)
        self.evidence = 0.0

    @property
    def share(self) -> float:
        """Probability that the network explains more than the zero network."""
        return 1.0 / (1.0 + math.exp(-min(max(self.evidence, -MOST_ODDS), MOST_ODDS)))

    def correct(self, sample: Sample) -> Correction:
        """Power that the network adds at a sample, weighted by its evidence."""
        force, gradient = self._output(sample)
        reach = self.share * abs(sample.speed)
        variance = float(gradient @ self._covariance @ gradient)
        return Correction(reach * force, reach * math.sqrt(max(0.0, variance)))

    def advance(self, duration: float) -> None:
        """Let s pass: weights return to the prior."""
        keep = math.exp(-duration / MEMORY)
        self._weights = self._start + keep * (self._weights - self._start)
        self._covariance *= keep**2
        self._covariance[np.diag_indices_from(self._covariance)] += (1.0 - keep**2) * self._prior

    def learn(self, sample: Sample, residual: float, duration: float) -> None:
        """Learn the residual of physics, W, of a sample that stands for some s."""
        v = abs(sample.speed)
        if v < STANDSTILL_SPEED:
            return
        force, gradient = self._output(sample)
        error = residual - v * force
        noise = STANDING_NOISE**2 + (FORCE_NOISE * v) ** 2
        with_it, without = (
            min(0.5 * each**2 / (noise * TEMPERATURE), MOST_LOSS) for each in (error, residual)
        )
        evidence = self.evidence * math.exp(-duration / EVIDENCE_TIME)
        self.evidence = evidence + duration * (without - with_it)
        along = v * (self._covariance @ gradient)
        variance = v * float(gradient @ along) + noise * CORRELATED
        beyond = max(1.0, abs(error) / (OUTLIER * math.sqrt(variance)))
        gain = along / (variance * beyond**2)
        self._weights = self._weights + gain * error
        self._covariance -= np.outer(gain, along)

    def _output(self, sample: Sample) -> tuple[float, np.ndarray]:
        """Output of the network, a force, N, and its gradient, shape (weights,)."""
        profile = sample.profile or (0.0,) * PROFILE
        raw = np.array([sample.speed, sample.acceleration, *profile])
        inputs = (raw - INPUT_CENTRE) / INPUT_SCALE
        count = UNITS * INPUTS
        inner = self._weights[:count].reshape(UNITS, INPUTS)
        outer = self._weights[count + UNITS : -1]
        hidden = np.tanh(inner @ inputs + self._weights[count : count + UNITS])
        slope = outer * (1.0 - hidden**2)
        force = float(outer @ hidden + self._weights[-1])
        return force, np.concatenate((np.outer(slope, inputs).ravel(), slope, hidden, [1.0]))
