"""The filter whose parameters are published: those with which eq. 12-21 spend the right energy.

No car has one efficiency. The constants that eq. 12-21 ask for are defined by energy, as
`simulation.truth` defines them: eta is wheel energy over battery energy while driving, mu battery
energy over wheel energy while braking, what the friction brakes take included. A regression of
power on wheel power gives other values: it believes whichever samples its weights favour. With
residuals that grow with speed these are launches at low speed, where copper loss is largest, so
mass/eta came out up to 8 % high and eta mu up to 20 % low.

So loss that grows with the square of force has a state of its own here, and the published values
are made of the whole by sums of energy over what was driven so far,

    eta_published = eta / (1 + c F_d / W_d),    mu_published = mu (1 - (c F_b + R_b) / (q W_b)),

with W the wheel energy over eta, F the integral of specific force squared, R_b the energy that
braking did not bring back although the model said so: below `BRAKE_FADE` every motor leaves the
work to the friction brakes, and what the robust weighting left aside is energy all the same.

At one speed nothing tells eta, mu or mass, so they are held: without that the forgetting of the
other states draws them along, and three hours on a motorway move m/eta by half a sigma.

The residual of a moving car has three causes, each with its own dependence (`_residual_variance`).
"""

from __future__ import annotations

from collections.abc import Mapping
import copy
import math
from typing import Any

import numpy as np

from evpinn_ros.estimation.evidence import Evidence, evidence
from evpinn_ros.estimation.parameter_filter import (
    COPPER,
    ETA,
    HOUR,
    MASS,
    MU,
    OUTLIER,
    P_AUX,
    SLOPE,
    STATES,
    ParameterFilter,
)
from evpinn_ros.estimation.window import Batch
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.physics import GRAVITY, STANDSTILL_SPEED, drag_force

LOSS_PRIOR = (200.0, 300.0)  # W/(m/s^2)^2, mean and 1-sigma: 1 % to 4 % of a launch at 1.5 m/s^2
STANDING_NOISE = 60.0  # W: fans, pumps, lights
TIMING_NOISE = 800.0  # W while moving: the pedal moves power by 25 kW/s, stamps agree to 0.03 s
FORCE_NOISE = 40.0  # N over eta: gusts and an acceleration known to 0.02 m/s^2
SHARE_NOISE = 0.03  # of the power that accelerates: a map of efficiency is not one number
EXCITING = 0.3  # m/s^2: less tells mass and efficiencies no better than slope and wind hide them
QUIET_AFTER = 60.0  # s without excitation; until then cruising tells the slope of the last launch
HELD = [ETA, MU, MASS, COPPER]  # what is told by excitation alone
BRAKE_FADE = 4.0  # m/s, below it the motor brakes less and less
ENERGY_FLOOR = 5e4  # J: a launch to town speed is more; less is no base for a share
ENERGY_MEMORY = 10 * HOUR  # s of driving over which the sums of energy are kept
SHARE_RANGE = (0.3, 3.0)  # of the published over the regressed values, no car leaves it
MAX_ENERGY = 1e12  # J, no saved sum is larger


class PublishedFilter(ParameterFilter):
    """See the module's text; `published` holds what is to be told."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Start at the priors of the vehicle file and with nothing driven."""
        super().__init__(vehicle, copper_loss=False)
        self._told = ParameterFilter(vehicle, copper_loss=False)
        self._prior_mean[COPPER], std = LOSS_PRIOR
        self._prior_variance[COPPER] = std**2
        self.mean = self._prior_mean.copy()
        self.covariance = np.diag(self._prior_variance)
        # Driving and braking: J of wheel energy over eta (times q in braking), and specific
        # force squared times time, m^2/s^3.
        self._energy = np.zeros((2, 2))
        self._lost = 0.0  # J that braking did not bring back
        self._quiet = 0.0  # s since the car last sped up or slowed down

    def advance(self, sample: Sample) -> None:
        """Let time pass up to a sample; what only excitation tells is forgotten only with it."""
        if abs(sample.acceleration) > EXCITING:
            self._quiet = 0.0
        else:
            self._quiet += self._step(sample)
        super().advance(sample)

    def update(self, sample: Sample, power: float, step: float) -> float:
        """Learn from measured power, W, that stands for `step` seconds; returns the residual, W.

        Call `advance` with the same sample first.
        """
        held = self.mean[HELD], self.covariance[np.ix_(HELD, HELD)]
        residual = super().update(sample, power, step)
        if self._quiet > QUIET_AFTER:
            # As Schmidt's filter has it: considered in what the others learn, not moved.
            self.mean[HELD], self.covariance[np.ix_(HELD, HELD)] = held
        elif abs(sample.speed) > STANDSTILL_SPEED:
            self.count(sample, power, step)
        return residual

    def published(self) -> ParameterFilter:
        """The values that are told, their covariance, shares and combinations."""
        told = self._told
        told.mean, told.covariance = self._published()
        told.noise_scale = self.noise_scale
        told.limit_states()
        return told

    def mass_over_eta(self) -> tuple[float, float]:
        """Logarithm of the published m / eta, kg, and its 1-sigma."""
        mean, covariance = self._published()
        variance = covariance[MASS, MASS] - 2 * covariance[MASS, ETA] + covariance[ETA, ETA]
        return float(mean[MASS] - mean[ETA]), math.sqrt(max(0.0, float(variance)))

    def fork(self, mass_std: float) -> PublishedFilter:
        """A copy that knows the mass less well, by this 1-sigma of its logarithm."""
        other = copy.deepcopy(self)
        other.covariance[MASS, MASS] += mass_std**2
        return other

    def export(self) -> dict[str, Any]:
        """State to save."""
        return {**super().export(), "energy": self._energy.tolist(), "lost": self._lost}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take a saved state; ValueError when it does not fit."""
        energy, lost = np.array(state["energy"], dtype=float), float(state["lost"])
        if energy.shape != (2, 2):
            raise ValueError("the saved energies have another shape")
        if not ((energy >= 0) & (energy <= MAX_ENERGY)).all() or not abs(lost) <= MAX_ENERGY:
            raise ValueError("the saved energies are out of range")
        super().restore(state)
        self._energy, self._lost = energy, lost

    def evidence(self) -> Evidence:
        """What the data alone said of the values that are told, without the prior."""
        mean, change = self._told_as()
        scale = np.sqrt(self._prior_variance)
        prior = self._prior_mean
        offset = (mean - prior - change @ (self.mean - prior)) / scale
        return evidence(
            (self.mean - prior) / scale,
            self.covariance / np.outer(scale, scale),
            np.column_stack((change * scale / scale[:, None], offset)),
        )

    def _published(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean, shape (8,), and covariance, shape (8, 8), of the values that are told."""
        mean, change = self._told_as()
        return mean, change @ self.covariance @ change.T

    def _told_as(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean of the values that are told, shape (8,), and how they follow the states, (8, 8)."""
        loss = self.mean[COPPER]
        (driven, force), (braked, braking_force) = self._energy
        driving = force / max(driven, ENERGY_FLOOR)
        braking = braking_force / max(braked, ENERGY_FLOOR)
        more = float(np.clip(1 + loss * driving, *SHARE_RANGE))
        back = 1 - loss * braking - self._lost / max(braked, ENERGY_FLOOR)
        back = float(np.clip(back, *SHARE_RANGE))
        mean, change = self.mean.copy(), np.eye(len(STATES))
        mean[ETA] -= math.log(more)
        mean[MU] += math.log(back)
        change[ETA, COPPER] = -driving / more
        change[MU, COPPER] = -braking / back
        return mean, change

    def count(self, sample: Sample, power: float, step: float) -> None:
        """Add one moving sample to the sums of energy; `update` does so."""
        expected, gradient = self._model(sample, self.mean[SLOPE])
        square = gradient[COPPER]
        wheel = self._wheel(expected, square, sample)
        self._energy *= math.exp(-step / ENERGY_MEMORY)
        self._lost *= math.exp(-step / ENERGY_MEMORY)
        if wheel > 0:
            self._energy[0] += (wheel * step, square * step)
            return
        self._energy[1] += (-wheel * step, square * step)
        residual = power - expected
        limit = OUTLIER * math.sqrt(self._residual_variance(sample))
        unexplained = residual - min(max(residual, -limit), limit)
        self._lost += (residual if abs(sample.speed) < BRAKE_FADE else unexplained) * step

    def _keep(self, sample: Sample, step: float) -> np.ndarray:
        keep = super()._keep(sample, step)
        if self._quiet > QUIET_AFTER:
            keep[HELD] = 1.0
        return keep

    def _model(self, sample: Sample | Batch, slope: Any) -> tuple[Any, np.ndarray]:
        """As in the base, with a loss that grows with the square of force, not acceleration.

        Nor is reported grade a known force to learn mass or efficiencies by: that of a barometer
        is as much noise as hill, and noise in a regressor makes m/eta small (by 1.2 %).
        """
        power, gradient = super()._model(sample, slope)
        climbing = gradient[..., SLOPE] * np.tan(sample.grade)
        braking = gradient[..., ETA] == 0.0
        gradient[..., MASS] -= climbing
        gradient[..., ETA] += np.where(braking, 0.0, climbing)
        gradient[..., MU] -= np.where(braking, climbing, 0.0)
        loss = self.mean[COPPER]
        power = power - loss * gradient[..., COPPER]
        v = sample.speed
        mass, c_rr, c_d = self.parameters()[2:5]
        area = self._vehicle.frontal_area * c_d
        force = (
            self._vehicle.rotating_mass_factor * sample.acceleration
            + GRAVITY * (c_rr + np.sin(sample.grade))
            + drag_force(v + sample.head_wind, area, sample.air_density) / mass
        )
        square = np.where(np.abs(v) > STANDSTILL_SPEED, np.square(force), 0.0)
        gradient[..., COPPER] = square
        return power + loss * square, gradient

    def _wheel(self, power: float, square: float, sample: Sample) -> float:
        """Power at the wheels as the battery would see it without loss of force, W."""
        rest = self.mean[P_AUX] + sample.known_auxiliary + self.mean[COPPER] * square
        return float(power - rest)

    def _residual_variance(self, sample: Sample) -> float:
        """Variance of the residual, W^2."""
        if abs(sample.speed) < STANDSTILL_SPEED:
            return STANDING_NOISE**2
        inertia = math.exp(self.mean[MASS] - self.mean[ETA]) * sample.acceleration
        share = SHARE_NOISE * inertia * sample.speed
        moving = TIMING_NOISE**2 + (FORCE_NOISE * sample.speed) ** 2 + share**2
        return STANDING_NOISE**2 + self.noise_scale * float(moving)
