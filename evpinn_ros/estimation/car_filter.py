"""The car, learned from intervals: a bank of extended Kalman filters in the weak form.

All hypotheses hold the same states (`car_state`). They differ in what no car knows beforehand: how
hilly and windy its roads are. Each is weighted by how well it predicted the intervals so far
(their evidence), so the widths of all intervals are learned.

Slope that no sensor reports is the derivative of a height that stays bounded: a Matern-3/2
process along the road (Rasmussen and Williams, 2006, eq. 4.17), so it has no mean and does not
compete with rolling resistance. Where height is measured, the process is the error of that height.
Longer hills (`long_hills`) widen what is predicted without battery and height.

During a battery dropout the predicted energy is a state too: its covariance with all others
makes its interval exact, however long that lasts.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
import math
from typing import Annotated, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.estimation.breakdown import FAST, PartSums, loss_shares
from evpinn_ros.estimation.calibration import MOST_SUM
from evpinn_ros.estimation.car_state import (
    CABIN_TIME,
    CAR,
    COMPARED_STD,
    DRIVE_KEPT,
    DRIVE_STD,
    DRIVES_KEPT,
    PRIOR_DRIVES,
    ROLL_WARM_TIME,
    SIZE,
    State,
    prior_of,
)
from evpinn_ros.estimation.energy_parts import COUNT
from evpinn_ros.estimation.gaussian import (
    MOST,
    Gaussian,
    Innovation,
    condition,
    innovate,
    is_possible,
    mixture,
    outlier_variance,
    predict,
    raise_to_zero,
    replace_states,
)
from evpinn_ros.estimation.interval_noise import (
    FORCE_NOISE,
    battery_variance,
    lost_variance,
    motor_variance,
)
from evpinn_ros.estimation.long_hills import BLOCKS_KEPT, GROWTH, PRIOR_BLOCKS, LongHills
from evpinn_ros.estimation.passage import ROAD, passage
from evpinn_ros.estimation.weak_form import Constants, Spent, Warmth, motor_energy, spent
from evpinn_ros.signals.interval import Interval
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.physics import GRAVITY, STANDSTILL_SPEED

# What the hypotheses are about: 1-sigma of the unseen slope and of the unseen force over the
# weight; and in place of the slope, of a measured height's error in m.
SLOPES, FORCES = (0.002, 0.008, 0.03), (0.0007, 0.002, 0.006)
HEIGHT_ERRORS = (0.3, 1.5, 6.0)
SLOPE_LENGTH, HEIGHT_ERROR_LENGTH = 600.0, 100.0  # m of road
FORCE_LENGTH = 1500.0  # m of road
# More would take what belongs to car and drive, and be forgotten with the road.
LOAD_STD, LOAD_TIME = 150.0, 300.0  # W of the wandering load, s
KNOWN_LOAD_STD = 30.0  # W of what wanders beside heating and cooling that the car reports
EVIDENCE_KEPT = 400.0  # intervals over which the hypotheses are judged

SCALE_INTERVALS = 60.0  # over which the scale of the noise is learned
LEAST_SCALE, MOST_SCALE = 0.05, 50.0
OUTLIER = 2.5  # sigmas
LOAD = slice(State.AUX, State.FORCE)
MOST_AWAY = 30.0  # prior sigmas, further no state was ever learned


def lasting(mean: np.ndarray) -> np.ndarray:
    """States, shape (..., SIZE), beyond the intervals learned: what is unseen of the road is zero.

    What the last road seemed to have was measured to mislead about the next. Its variance stays.
    """
    mean = mean.copy()
    mean[..., State.FORCE : State.ENERGY] = 0.0
    return mean


class Learned(NamedTuple):
    """The innovation of one interval: mixture residual, J, and its 1-sigma, J."""

    residual: float
    sigma: float


@dataclass(frozen=True, slots=True)
class SavedFilter:
    """States of each hypothesis, their evidence and scale of noise, and this drive."""

    mean: Annotated[np.ndarray, Range(-MOST, MOST)]
    covariance: Annotated[np.ndarray, Range(-(MOST**2), MOST**2)]
    evidence: Annotated[np.ndarray, Range(-MOST_SUM, MOST_SUM)]
    scale: Annotated[np.ndarray, Range(LEAST_SCALE, MOST_SCALE)]
    drive_variance: Annotated[np.ndarray, Range(0.0, 1e8)]
    drives: Annotated[float, Range(PRIOR_DRIVES, DRIVES_KEPT)]
    intervals: Annotated[int, Range(0, 10**12)]
    seconds: Annotated[float, Range(0.0, 1e7)]
    height_growth: Annotated[float, Range(0.0, 1e3)]
    height_blocks: Annotated[float, Range(PRIOR_BLOCKS, BLOCKS_KEPT)]


class CarFilter(Saveable[SavedFilter]):
    """See the module's text. Intervals must come in order of time.

    Attributes:
        constants: of the car, that are not learned.
        state: means and covariances of the K hypotheses.
        intervals: how many this drive was learned from.
        parts: where the energy of this drive went, None in a copy that need not know.
        hills: how far roads stray from the height they began at.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        """Start at the priors of a vehicle file."""
        self.constants = Constants.of(vehicle)
        self.prior = prior_of(vehicle)
        self._hypotheses = np.array(list(product(range(len(SLOPES)), FORCES)))
        count = len(self._hypotheses)
        one = self.prior.mean, self.prior.covariance
        self.state = Gaussian(*(np.repeat(each[None], count, axis=0) for each in one))
        self._evidence = np.zeros(count)
        self._scale = np.ones(count)
        self._drive_variance = {state: std**2 for state, std in DRIVE_STD.items()}
        self._drives = PRIOR_DRIVES
        self.intervals = 0
        self.parts: PartSums | None = PartSums.none(count)
        self.hills = LongHills(GROWTH)
        self._seconds = 0.0  # of this drive
        self.state = replace_states(self.state, self._drive_variance)
        self._height_known = self._load_known = False
        self.forget_road()

    def begin_drive(self, keep: bool = False, *, goes_on: bool = False) -> None:
        """Another drive: another road, and other offsets, of which some is as it was.

        With `keep` the sums of the drives before stay, to compare, and no offset is as it was.
        Where the breakdown `goes_on`, as over a long stop in a recording, its sums do too.

        The variance of what is of a drive is learned from the drive that was (expectation
        maximisation with a prior of `PRIOR_DRIVES` drives).
        """
        kept, fresh = np.ones(SIZE), np.zeros(SIZE)
        share, more = (0.0, COMPARED_STD) if keep else (DRIVE_KEPT, {})
        if self.intervals:
            whole = self.mixture()
            for state, before in self._drive_variance.items():
                found = whole.mean[state] ** 2 + whole.covariance[state, state]
                self._drive_variance[state] = (self._drives * before + found) / (self._drives + 1)
            self._drives = min(self._drives + 1, DRIVES_KEPT)
            for state, variance in self._drive_variance.items():
                kept[state] = share
                fresh[state] = (1.0 - share**2) * variance + more.get(state, 0.0) ** 2
            self.state = predict(self.state, np.diag(kept), np.diag(fresh))
        self.intervals, self._seconds = 0, 0.0
        if self.parts is not None and (keep or goes_on):
            self.parts = self.parts.next_drive(kept) if keep else self.parts.offset(kept)
        else:
            self.parts = PartSums.none(len(self._scale))
        self.forget_road()

    def forget_road(self) -> None:
        """After a jump of time: another place on the road."""
        self._begin(FAST)
        self.state = replace_states(self.state, {State.ENERGY: 0.0})
        self.hills = self.hills.elsewhere()

    def learn(self, interval: Interval) -> Learned | None:
        """Let an interval pass and learn from it; None where its battery was not measured.

        Where it was not, its energy is added to what is predicted (`unmeasured`).
        """
        self._pass(interval)
        if interval.steps.motor_known:
            self._learn_motor(interval)
        dropout = math.isnan(interval.energy)
        states = lasting(self.state.mean) if dropout else self.state.mean
        passed = interval.steps, interval.conditions, self.warmth, self.constants
        found = spent(states, *passed)
        noise = battery_variance(interval, found, self._scale)
        if dropout:
            self._accumulate(found, noise + self._weight**2 * self.hills.unseen(interval))
            return None
        self.state = replace_states(self.state, {State.ENERGY: 0.0})
        weights = self.weights
        lost = (self._scale * lost_variance(interval, found))[:, None] * loss_shares(found)
        seen = self._see(found.gradient, interval.energy - found.energy, noise, lost)
        self._keep_losses_positive()
        known = interval, self.state, weights, self.warmth, self.constants
        self.parts = self.parts and self.parts.plus(*known)
        if abs(interval.distance) > STANDSTILL_SPEED * interval.duration:
            self._judge(seen)  # a standing car is not informative on slopes, winds and their noise
        self.intervals += 1
        mean = float(weights @ seen.residual)
        variance = weights @ (seen.variance + (seen.residual - mean) ** 2)
        return Learned(mean, math.sqrt(float(variance)))

    def fork(self, mass_std: float) -> CarFilter:
        """A copy that knows the mass less well, by this 1-sigma of its logarithm."""
        other = self.copy()
        other.state.covariance[:, State.MASS, State.MASS] += mass_std**2
        other.parts = None
        return other

    def copy(self) -> CarFilter:
        """An independent copy."""
        other = object.__new__(CarFilter)
        other.__dict__.update(self.__dict__)
        other.state = Gaussian(self.state.mean.copy(), self.state.covariance.copy())
        other._drive_variance = dict(self._drive_variance)
        return other

    @property
    def weights(self) -> np.ndarray:
        """Probability of each hypothesis, shape (K,)."""
        weights = np.exp(self._evidence - self._evidence.max())
        return np.asarray(weights / weights.sum())

    def mixture(self) -> Gaussian:
        """Mean, shape (SIZE,), and covariance over all hypotheses."""
        return mixture(self.weights, self.state)

    def unmeasured(self) -> tuple[float, float]:
        """Energy predicted since the battery was last measured, J, and its 1-sigma."""
        whole = self.mixture()
        variance = float(whole.covariance[State.ENERGY, State.ENERGY])
        return float(whole.mean[State.ENERGY]), math.sqrt(max(0.0, variance))

    @property
    def warmth(self) -> Warmth:
        """Coldness of tyres and cabin now."""
        return Warmth(
            math.exp(-self._seconds / ROLL_WARM_TIME), math.exp(-self._seconds / CABIN_TIME)
        )

    @property
    def spread(self) -> np.ndarray:
        """1-sigma of the prior of every state of car and drive, shape (SIZE,)."""
        spread = self.prior.std.copy()
        for state, variance in self._drive_variance.items():
            spread[state] = math.sqrt(variance)
        return spread

    @property
    def hilliness(self) -> float:
        """1-sigma of the unseen force over the weight, slopes and winds together."""
        slopes, forces = self._scales()
        return math.sqrt(float(self.weights @ (slopes**2 + forces**2)))

    def force_noise(self) -> float:
        """1-sigma of what no state explains while moving, N, over `NOISE_TIME`."""
        return FORCE_NOISE * math.sqrt(float(self.weights @ self._scale))

    def saved(self) -> SavedFilter:
        """State to save."""
        return SavedFilter(
            mean=self.state.mean,
            covariance=self.state.covariance,
            evidence=self._evidence,
            scale=self._scale,
            drive_variance=np.array([self._drive_variance[state] for state in DRIVE_STD]),
            drives=self._drives,
            intervals=self.intervals,
            seconds=self._seconds,
            height_growth=self.hills.growth,
            height_blocks=self.hills.blocks,
        )

    def take(self, saved: SavedFilter) -> None:
        """Go on from a state; ValueError of what no drive leaves: no Gaussian, or far away."""
        state = Gaussian(saved.mean, saved.covariance)
        away = np.abs(saved.mean[:, CAR] - self.prior.mean[CAR]) / self.prior.std[CAR]
        if not (is_possible(state) and away.max() <= MOST_AWAY):
            raise ValueError("the filter is out of range")
        self.state, self._evidence, self._scale = state, saved.evidence, saved.scale
        self._drive_variance = dict(zip(DRIVE_STD, saved.drive_variance.tolist(), strict=True))
        self._drives, self._seconds = saved.drives, saved.seconds
        self.intervals = saved.intervals
        self.hills = LongHills(saved.height_growth, saved.height_blocks)
        # As in a new filter, so that what follows is the same.
        self._height_known = self._load_known = False

    @property
    def load_std(self) -> float:
        """1-sigma of the wandering load, W."""
        return KNOWN_LOAD_STD if self._load_known else LOAD_STD

    @property
    def _slope_length(self) -> float:
        return HEIGHT_ERROR_LENGTH if self._height_known else SLOPE_LENGTH

    def _scales(self) -> tuple[np.ndarray, np.ndarray]:
        """1-sigma of slope and force of each hypothesis, shape (K,) each."""
        level, forces = self._hypotheses.T
        errors = np.array(HEIGHT_ERRORS) * math.sqrt(3.0) / HEIGHT_ERROR_LENGTH
        slopes = errors if self._height_known else np.array(SLOPES)
        return slopes[level.astype(int)], forces

    def _pass(self, interval: Interval) -> None:
        """Let time and road pass: fast states forget themselves, height gives the climb."""
        # What begins or ceases to be reported leaves something else unseen.
        if interval.height_known != self._height_known:
            self._height_known = interval.height_known
            self._begin(ROAD)
        if interval.conditions.load_known != self._load_known:
            self._load_known = interval.conditions.load_known
            self._begin(LOAD)
        distance, duration = abs(interval.distance), interval.duration
        self._seconds += duration
        self.hills = self.hills.after(interval)
        slopes, forces = self._scales()
        kept: dict[State, tuple[float, float | np.ndarray]] = {
            State.AUX: (math.exp(-duration / LOAD_TIME), self.load_std),
            State.FORCE: (math.exp(-distance / FORCE_LENGTH), forces),
        }
        rate = math.sqrt(3.0) / self._slope_length
        transition, noise = passage(rate, distance, slopes, kept)
        self.state = predict(self.state, transition, noise)
        self.parts = self.parts and self.parts.passed(transition)

    def _begin(self, states: slice) -> None:
        """Begin some of the fast states anew."""
        slopes, forces = self._scales()
        height = slopes * self._slope_length / math.sqrt(3.0)
        variances = self.load_std**2, forces**2, height**2, slopes**2, 0.0
        fresh = dict(zip(range(SIZE)[FAST], variances, strict=True))
        self.state = replace_states(self.state, {s: fresh[s] for s in range(SIZE)[states]})
        self.parts = self.parts and self.parts.without(states)

    @property
    def _weight(self) -> np.ndarray:
        """Weight of the car over eta, N, shape (K,)."""
        mean = self.state.mean
        return np.asarray(GRAVITY * np.exp(mean[:, State.MASS] - mean[:, State.ETA]))

    def _learn_motor(self, interval: Interval) -> None:
        """Condition on the motor's energy: what the wheels take, whatever the battery gave."""
        steps = interval.steps
        for part, measured in enumerate((steps.motor_drive.sum(), steps.motor_brake.sum())):
            passed = steps, interval.conditions, self.warmth, self.constants
            energy, gradient = motor_energy(self.state.mean, *passed)[part]
            most = np.maximum(energy, measured)
            noise = motor_variance(interval, most, self._scale, braking=part == 1)
            self._see(gradient, measured - energy, noise, np.zeros((1, COUNT)))

    def _see(
        self, gradient: np.ndarray, residual: np.ndarray, noise: np.ndarray, lost: np.ndarray
    ) -> Innovation:
        """Condition on an energy, of whose noise this much is lost in parts, J^2, (K, COUNT)."""
        seen = innovate(self.state, gradient, residual, noise)
        extra = outlier_variance(seen, noise, OUTLIER)
        self.state = condition(self.state, seen, extra)
        heavy = lost * (1.0 + extra / noise)[:, None]
        self.parts = self.parts and self.parts.given(seen, gradient, extra, heavy)
        return seen

    def _keep_losses_positive(self) -> None:
        """Nothing gains energy by turning: what that would explain is rolling resistance."""
        for loss in (State.NO_LOAD, State.COPPER):
            self.state, share = raise_to_zero(self.state, loss)
            self.parts = self.parts and self.parts.moved(loss, share)

    def _accumulate(self, found: Spent, noise: np.ndarray) -> None:
        """Add the energy of an interval to what is predicted, with its covariances."""
        mean, covariance = self.state.mean.copy(), self.state.covariance
        mean[:, State.ENERGY] += found.energy
        transition = np.tile(np.eye(SIZE), (len(mean), 1, 1))
        transition[:, State.ENERGY] += found.gradient
        covariance = transition @ covariance @ np.swapaxes(transition, 1, 2)
        covariance[:, State.ENERGY, State.ENERGY] += noise
        self.state = Gaussian(mean, covariance)

    def _judge(self, seen: Innovation) -> None:
        """Weigh the hypotheses by the evidence, and learn the scale of their noise."""
        square = seen.residual**2 / seen.variance
        likelihood = -0.5 * (np.minimum(square, 2 * OUTLIER**2) + np.log(seen.variance))
        evidence = self._evidence * (1.0 - 1.0 / EVIDENCE_KEPT) + likelihood
        self._evidence = evidence - evidence.max()
        growth = np.exp((np.minimum(square, OUTLIER**2) - 1.0) / SCALE_INTERVALS)
        self._scale = np.clip(self._scale * growth, LEAST_SCALE, MOST_SCALE)
