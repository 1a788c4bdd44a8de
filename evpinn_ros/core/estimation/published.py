"""Projects the states of a car on the parameters of eq. 12-21, which are published.

The posterior holds more than eq. 21: a network, heat by force squared, a drivetrain that turns.
The published parameters are the least-squares fit of eq. 21 to the learned power over all driving
so far. The same fit, `project`, gives the truth of a simulated car. Where the driving does not
determine a parameter (C_d in town) the fit leaves it at its state. Driving in town hardly
separates drag from rolling, so what the network learned there would be published as more rolling
and less drag. `REFERENCE_SECONDS` of a reference drive, over which the network holds nothing of
eq. 21, are therefore added to the driving.

C_rr is that of this drive, with its cold and its tyres; p_aux is the standing load. On a road
without heights, a climb looks like rolling resistance and drag, so their sigmas include the climb
that such a road may have. If the errors of rehearsed dropouts exceed their sigma, all sigmas grow
accordingly, up to those before any drive.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Annotated, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.estimation.breakdown import MOSTLY_UNSEEN, climb_as_rolling
from evpinn_ros.core.estimation.evidence import Evidence, evidence, file_prior
from evpinn_ros.core.estimation.gaussian import Gaussian
from evpinn_ros.core.estimation.journey import unseen_of
from evpinn_ros.core.estimation.posterior import CarState, IntervalTerms, initial_state
from evpinn_ros.core.estimation.states import NAMES, PHYSICS, SIZE, State, known_names
from evpinn_ros.core.estimation.terms import (
    BESIDE,
    TYRES,
    WARM,
    Equation,
    coldness,
    standing_powers,
)
from evpinn_ros.core.signals.road import Conditions

DRIVING_MEMORY = 36_000.0  # s, time constant with which driving is forgotten
# Density of unexplained power, W^2 s; with less the projection is not determined.
NOISE_DENSITY = 2.7e5
# By likelihood of the parameters of 72 simulated drives that no benchmark scores.
REFERENCE_SECONDS = 200.0
SHARE_RANGE = (0.3, 3.0)  # of braking energy over that of the prior; no car is outside
FIRST_METRES = 1000.0  # that the road of the drive before counts as
LEAST_RETURNED = 0.01  # share of braking energy; an offset of the current may give as much
BRAKED_FLOOR = 5e4  # J of braking; less gives no share
# An efficiency is a map, so a single number depends on the road: least 1-sigma of the logarithm,
# however much is learned. By likelihood of 72 simulated drives that no benchmark scores.
MAP_STD = (0.003, 0.015)  # of eta, mu
CLIMB_AS_DRAG = 0.005  # C_rr that an e-fold of drag looks like in town
ETA, MU, MASS, C_RR, C_D, P_AUX = range(6)
LOGARITHMIC = [ETA, MU, MASS, C_D]


@dataclass(frozen=True, slots=True)
class Driven:
    """Sums over the steps of all driving of a car, for `project`.

    Attributes:
        gram: products of the terms of eq. 21 over the duration, J^2/s per units, shape (4, 4).
        cross: products of these terms with the rows of `BESIDE`, shape (4, len(BESIDE)).
        braked: drag, rolling and inertia terms where the car brakes, shape (3,).
        distance: of this drive, m.
        cold_tyres: integral of the coldness of the tyres over it, m.
        load_known: whether the car reports its heating.
        unseen: share of the distance where no height was known; until a drive begins to move,
            that of the drive before.
        returned: energy that went back into the battery, J, forgotten as `braked` is; None if
            unknown.
        names: of the states of `cross`.
    """

    gram: Annotated[np.ndarray, Range(-1e30, 1e30, shape=(4, 4))]
    cross: Annotated[np.ndarray, Range(-1e30, 1e30, shape=(4, None))]
    braked: Annotated[np.ndarray, Range(-1e15, 1e15, shape=(3,))]
    distance: Annotated[float, Range(0.0, 1e12)] = 0.0
    cold_tyres: Annotated[float, Range(0.0, 1e12)] = 0.0
    load_known: bool = False
    unseen: Annotated[float, Range(0.0, 1.0)] | None = None
    returned: Annotated[float, Range(0.0, 1e15)] | None = None
    names: tuple[str, ...] = tuple(NAMES[state] for state in BESIDE)

    @classmethod
    def nowhere(cls) -> Driven:
        """Sums before any driving."""
        return cls(np.zeros((4, 4)), np.zeros((4, len(BESIDE))), np.zeros(3), returned=0.0)

    def of_this_version(self) -> Driven:
        """Saved driving in the states of this version; those that the file lacks have zeros.

        Raises:
            ValueError: numbers are missing.
        """
        if self.cross.shape != (4, len(self.names)):
            raise ValueError("numbers of the driving are missing")
        theirs, ours = known_names(self.names)
        columns = np.zeros((4, SIZE))
        columns[:, ours] = self.cross[:, theirs]
        return replace(self, cross=columns[:, BESIDE], names=Driven.nowhere().names)

    def plus(self, terms: IntervalTerms) -> Driven:
        """The sums with one more interval; of one with motor torque, distances alone."""
        interval, wheels = terms.interval, terms.wheels
        now = self._farther(abs(interval.distance), float(terms.warmth.tyres), unseen_of(interval))
        if interval.steps.motor_known:
            return now
        keep = math.exp(-interval.duration / DRIVING_MEMORY)
        physics = terms.rows[:, PHYSICS]
        over = (physics / interval.steps.duration[:, None]).T
        braking = 1.0 - wheels.driving
        moved = wheels.drag, wheels.rolling, wheels.inertia + wheels.climb
        returned = None
        if self.returned is not None and not math.isnan(interval.returned):
            returned = keep * self.returned + interval.returned
        return replace(
            now,
            gram=keep * self.gram + over @ physics,
            cross=keep * self.cross + over @ terms.rows[:, BESIDE],
            braked=keep * self.braked
            + np.array([float(braking @ energies) for energies in moved]),
            load_known=interval.conditions.load_known,
            returned=returned,
        )

    def _farther(self, distance: float, tyres: float, unseen: float) -> Driven:
        whole = self.distance + distance
        if whole == 0.0:
            return self
        before = 0.0 if self.unseen is None else max(self.distance, FIRST_METRES)
        share = ((self.unseen or 0.0) * before + unseen) / (before + distance)
        cold = self.cold_tyres + distance * tyres
        return replace(self, distance=whole, cold_tyres=cold, unseen=share)

    def next_drive(self) -> Driven:
        """The sums at the start of another drive, with other tyres and weather."""
        return replace(self, distance=0.0, cold_tyres=0.0)

    def share(self, equation: Equation) -> np.ndarray:
        """Share of the terms of eq. 21 in one unit of each of `BESIDE`, shape (4, len(BESIDE))."""
        gram = self.gram + REFERENCE_SECONDS * equation.reference_gram
        return project(gram, self.cross, equation)

    def braked_share(self, equation: Equation, terms: np.ndarray) -> float:
        """Braking energy of the prior car over that of a car with these terms, kept to a range."""
        before = -float(self.braked @ equation.mean[PHYSICS[:3]])
        braked_energy = -float(self.braked @ terms)
        if min(before, braked_energy) < BRAKED_FLOOR:
            return 1.0
        return float(np.clip(before / braked_energy, *SHARE_RANGE))

    def regenerates(self, equation: Equation) -> bool:
        """False if the car braked and almost nothing came back, so that mu is not observed."""
        braked = -float(self.braked @ equation.mean[PHYSICS[:3]])
        return self.returned is None or self.returned >= LEAST_RETURNED * braked


def project(gram: np.ndarray, cross: np.ndarray, equation: Equation) -> np.ndarray:
    """Changes of the coefficients of eq. 21 that fit k energies, shape (4, k).

    Least squares of power with the prior of the coefficients and noise of `NOISE_DENSITY`:
    coefficients that the driving does not determine (drag in town) stay at their prior.

    Args:
        gram: products of the terms of eq. 21 over the duration of their steps, shape (4, 4).
        cross: products of these terms with k energies of the steps, shape (4, k).
        equation: of the car.
    """
    prior = equation.covariance[np.ix_(PHYSICS, PHYSICS)]
    scale = np.sqrt(np.diag(prior))
    ridge = NOISE_DENSITY * np.linalg.inv(prior / np.outer(scale, scale))
    solution = np.linalg.solve(gram * np.outer(scale, scale) + ridge, scale[:, None] * cross)
    return np.asarray(scale[:, None] * solution)


class Published(NamedTuple):
    """The six parameters, eta, mu, mass and C_d as logarithms, now and before any drive.

    Attributes:
        now: by all that was learned.
        prior: before any drive.
        frontal_area: m^2.
        hills_seen: whether the heights of most of the road are known.
        regenerates: whether any energy came back; otherwise mu is not observed.
    """

    now: Gaussian
    prior: Gaussian
    frontal_area: float
    hills_seen: bool = True
    regenerates: bool = True


def published(state: CarState, equation: Equation, driven: Driven) -> Published:
    """The parameters of a state, with at least the sigma of an efficiency map."""
    celsius = None if driven.load_known else state.celsius
    now = _pushed(state.mixture(), equation, driven, celsius)
    before = _pushed(_prior(state, equation), equation, driven, celsius)
    # On real roads errors of neighbouring intervals are correlated, as rehearsed dropouts show.
    most = np.diag(before.covariance) / np.diag(now.covariance)
    grow = np.sqrt(np.clip(most, 1.0, max(1.0, state.bands.dropout.seen)))
    now = now._replace(covariance=now.covariance * np.outer(grow, grow))
    for index, std in enumerate(MAP_STD):
        now.covariance[index, index] += std**2
    share = driven.unseen or 0.0
    climb = share * climb_as_rolling(share * driven.distance)  # C_rr is of the whole drive
    for index, std in ((C_RR, climb), (C_D, climb / CLIMB_AS_DRAG)):
        variance, widest = (float(gaussian.covariance[index, index]) for gaussian in (now, before))
        now.covariance[index, index] = max(variance, min(variance + std**2, widest))
    return Published(
        now,
        before,
        equation.vehicle.frontal_area,
        hills_seen=share <= MOSTLY_UNSEEN,
        regenerates=driven.regenerates(equation),
    )


def _prior(state: CarState, equation: Equation) -> Gaussian:
    """The states before any drive, with the present evidence of the hypotheses.

    So learning only shrinks the covariance.
    """
    return replace(initial_state(equation), evidence=state.evidence).mixture()


def evidence_of(state: CarState, equation: Equation, driven: Driven) -> Evidence:
    """Likelihood of the published parameters without their prior, in sigmas of the vehicle file.

    Their prior is wider than the file: terms that eq. 21 leaves out are part of the published
    parameters.
    """
    whole, prior = state.mixture(), _prior(state, equation)
    celsius = None if driven.load_known else state.celsius
    values, rows = _linear(whole.mean, equation, driven, celsius)
    c_rr = max(float(values[C_RR]), 1e-4)
    rows[C_RR], values[C_RR] = rows[C_RR] / c_rr, math.log(c_rr)
    # Both about the same mean: directions without data must have the same variance in both.
    now = Gaussian(values, rows @ whole.covariance @ rows.T)
    before = Gaussian(values + rows @ (prior.mean - whole.mean), rows @ prior.covariance @ rows.T)
    for index, std in enumerate(MAP_STD):
        now.covariance[index, index] += std**2
    scale = np.sqrt(np.diag(before.covariance))
    correlation = before.covariance / np.outer(scale, scale)
    likelihood = evidence(
        (now.mean - before.mean) / scale, now.covariance / np.outer(scale, scale), correlation
    )
    file_mean, file_std = file_prior(equation.vehicle)
    return likelihood.about((file_mean - before.mean) / scale, file_std / scale)


def _pushed(
    source: Gaussian, equation: Equation, driven: Driven, celsius: float | None
) -> Gaussian:
    """Mean and covariance of the six parameters, to first order."""
    values, rows = _linear(source.mean, equation, driven, celsius)
    return Gaussian(values, rows @ source.covariance @ rows.T)


def _linear(
    mean: np.ndarray, equation: Equation, driven: Driven, celsius: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """The six parameters at a mean of the states, and their gradients, shape (6, SIZE)."""
    state = np.eye(SIZE)
    theta = state[PHYSICS]
    theta[:, BESIDE] = driven.share(equation)
    prior = equation.mean[State.ROLLING]
    tyres = driven.cold_tyres / max(driven.distance, 1.0)
    theta[1, TYRES] = prior * np.array([coldness(celsius), tyres, 1.0])
    theta[1:3, State.MASS_DRIVE] = prior / equation.mean[State.MASS_OVER_ETA], 1.0
    drag, rolling, mass, back = (theta @ mean).tolist()
    drag, rolling, mass = (max(value, 1e-3) for value in (drag, rolling, mass))
    share = driven.braked_share(equation, np.array([drag, rolling, mass]))
    regeneration = min(max(equation.back + share * back, 0.01), 1.5)
    eta = min(max(equation.eta + float(mean[State.ETA]), 0.05), 1.2)
    log_eta, log_mass = state[State.ETA] / eta, theta[2] / mass
    standing = np.zeros(SIZE)
    of_the_weather = Conditions(1.0, 0.0, celsius, load=0.0, load_known=False)
    for load, power in standing_powers(of_the_weather, WARM).items():
        standing[load] = power
    standing[State.LOAD] = 0.0  # it wanders
    rows = np.array([
        log_eta,
        share * theta[3] / regeneration - log_eta,
        log_mass + log_eta,
        (theta[1] - rolling * log_mass) / mass,
        theta[0] / drag + log_eta,
        standing,
    ])  # fmt: skip
    values = np.array([
        math.log(eta),
        math.log(regeneration / eta),
        math.log(mass * eta),
        rolling / mass,
        math.log(drag * eta / equation.vehicle.frontal_area),
        float(rows[P_AUX] @ mean),
    ])  # fmt: skip
    return values, rows
