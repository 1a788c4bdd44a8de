"""From the states of the car to the parameters of eq. 12-21, as they are on this drive.

The filter keeps losses apart that eq. 21 has in eta and mu: heat that grows with force squared,
and braking that friction takes at a walking pace. Sums of energy over the drives turn them into
the constants with which eq. 21 spends the same energy. C_rr is that of this drive, with its cold
and its tyres; p_aux is the standing load. What a drivetrain loses by turning is neither.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.estimation.car_filter import CarFilter
from evpinn_ros.estimation.car_state import MILD_CELSIUS, PARAMETERS, SIZE, State
from evpinn_ros.estimation.evidence import Evidence, evidence
from evpinn_ros.estimation.gaussian import Gaussian
from evpinn_ros.estimation.weak_form import Spent
from evpinn_ros.signals.interval import Interval
from evpinn_ros.signals.road import TEMPERATURES

ENERGY_FLOOR = 5e4  # J: a launch to town speed is more; less is no base for a share
ENERGY_MEMORY = 36_000.0  # s of driving over which the sums are kept
SHARE_RANGE = (0.3, 3.0)  # of published over learned values, no car leaves it
Amount: TypeAlias = Annotated[float, Range(0.0, 1e12)]
LOGARITHMIC = [State.ETA, State.MU, State.MASS, State.C_D]
LASTING = slice(0, State.AUX)  # states of car and drive
# An efficiency is a map, and one number for it depends on the road: 1-sigma of the logarithm that
# is left however much is learned. By likelihood of 72 simulated drives that no benchmark scores.
MAP_STD = {State.ETA: 0.003, State.MU: 0.015}


@dataclass(slots=True)
class EnergySums:
    """Energy spent so far, by the most probable hypothesis, and the cold it was spent in.

    Attributes:
        driven: at the wheels where they drive, J.
        driven_force: integral of (force over mass)^2 there, m^2/s^3.
        braked: the same where they brake, J.
        braked_force: the same.
        recovered: of `braked`, what recuperation can take, J.
        distance: of this drive, m.
        cold_tyres: of it, how much is to be added for tyres not yet warm, m.
        celsius: temperature outside, None while unknown.
        load_known: whether the car reports its heating.
    """

    driven: Amount = 0.0
    driven_force: Amount = 0.0
    braked: Amount = 0.0
    braked_force: Amount = 0.0
    recovered: Amount = 0.0
    distance: Amount = 0.0
    cold_tyres: Amount = 0.0
    celsius: Annotated[float, Range(*TEMPERATURES)] | None = None
    load_known: bool = False

    def add(self, interval: Interval, found: Spent, weights: np.ndarray, tyres: float) -> None:
        """Count an interval."""
        keep = math.exp(-interval.duration / ENERGY_MEMORY)
        braked = weights @ found.wheel_brake
        for name, value in (
            ("driven", weights @ found.wheel_drive),
            ("driven_force", weights @ found.force_drive),
            ("braked", braked),
            ("braked_force", weights @ found.force_brake),
            ("recovered", weights @ (found.recovered * found.wheel_brake)),
        ):
            setattr(self, name, keep * getattr(self, name) + float(value))
        self.distance += abs(interval.distance)
        self.cold_tyres += abs(interval.distance) * tyres
        self.celsius = interval.conditions.celsius
        self.load_known = interval.conditions.load_known

    def begin_drive(self) -> None:
        """Another drive: other tyres and weather."""
        self.distance = self.cold_tyres = 0.0


class Published(NamedTuple):
    """The six parameters, eta, mu, mass and C_d as logarithms, with their prior.

    Attributes:
        now: mean, shape (6,), and covariance, shape (6, 6).
        prior: the same, before any drive.
        frontal_area: m^2.
    """

    now: Gaussian
    prior: Gaussian
    frontal_area: float


def published(car: CarFilter, sums: EnergySums) -> Published:
    """The parameters that the filter stands for, no surer than a map of efficiency allows."""
    whole = car.mixture()
    matrix, offset = _affine(car, sums, whole.mean)
    prior = Gaussian(car.prior.mean, car.prior.covariance)
    now, before = (
        Gaussian(matrix @ each.mean + offset, matrix @ each.covariance @ matrix.T)
        for each in (whole, prior)
    )
    for state, std in MAP_STD.items():
        now.covariance[state, state] += std**2
    return Published(now, before, car.constants.frontal_area)


def mass_over_eta(car: CarFilter, sums: EnergySums) -> tuple[float, float]:
    """Logarithm of the published m / eta, kg, and its 1-sigma, to compare it with itself later."""
    whole = car.mixture()
    matrix, offset = _affine(car, sums, whole.mean)
    mean, covariance = matrix @ whole.mean + offset, matrix @ whole.covariance @ matrix.T
    direction = np.zeros(6)
    direction[[State.MASS, State.ETA]] = 1.0, -1.0
    return float(direction @ mean), math.sqrt(float(direction @ covariance @ direction))


def evidence_of(car: CarFilter, sums: EnergySums) -> Evidence:
    """Likelihood of the published parameters without their prior, all but p_aux as logarithms.

    The states are those of car and drive; published parameters stand in place of the first six.
    """
    whole, count = car.mixture(), LASTING.stop
    matrix, offset = np.eye(SIZE), np.zeros(SIZE)
    matrix[PARAMETERS], offset[PARAMETERS] = _affine(car, sums, whole.mean)
    # C_rr as a logarithm, linear about what it is now.
    rolling = float(matrix[State.C_RR] @ whole.mean + offset[State.C_RR])
    matrix[State.C_RR] /= rolling
    offset[State.C_RR] = offset[State.C_RR] / rolling - 1.0 + math.log(rolling)
    matrix, offset = matrix[:count, :count], offset[:count]
    before, scale = car.prior.mean[:count], car.spread[:count]
    reference = before.copy()
    reference[State.C_RR] = math.log(car.constants.c_rr)
    return evidence(
        (whole.mean[:count] - before) / scale,
        whole.covariance[:count, :count] / np.outer(scale, scale),
        np.column_stack(
            (matrix * scale / scale[:, None], (matrix @ before + offset - reference) / scale)
        ),
    )


def _affine(car: CarFilter, sums: EnergySums, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Affine map from the states to the published parameters about a mean: (6, SIZE) and (6,)."""
    matrix, offset = np.zeros((6, SIZE)), np.zeros(6)
    matrix[:, PARAMETERS] = np.eye(6)
    eta, mu = math.exp(mean[State.ETA]), math.exp(mean[State.MU])
    loss = mean[State.COPPER]
    driving = eta * sums.driven_force / max(sums.driven, ENERGY_FLOOR)
    braking = sums.braked_force / max(sums.braked, ENERGY_FLOOR) / mu
    unused = 1.0 - sums.recovered / sums.braked if sums.braked > ENERGY_FLOOR else 0.0
    more = float(np.clip(1.0 + loss * driving, *SHARE_RANGE))
    back = float(np.clip(1.0 - loss * braking - unused, *SHARE_RANGE))
    matrix[State.ETA, State.COPPER] = -driving / more
    offset[State.ETA] = loss * driving / more - math.log(more)
    matrix[State.MU, State.COPPER] = -braking / back
    offset[State.MU] = loss * braking / back + math.log(back)
    _rolling(matrix, offset, sums, mean, car.constants.c_rr)
    away = 0.0 if sums.celsius is None or sums.load_known else sums.celsius - MILD_CELSIUS
    matrix[State.P_AUX, State.AUX_DRIVE] = 1.0
    matrix[State.P_AUX, State.COLD] = max(0.0, -away)
    matrix[State.P_AUX, State.HOT] = max(0.0, away)
    return matrix, offset


def _rolling(
    matrix: np.ndarray, offset: np.ndarray, sums: EnergySums, mean: np.ndarray, c_rr: float
) -> None:
    """C_rr of this drive, in its temperature and with its tyres."""
    cold = 0.0 if sums.celsius is None else max(0.0, MILD_CELSIUS - sums.celsius) / 10.0
    own = mean[State.C_RR] * mean[State.ROLL_COLD] * cold
    matrix[State.C_RR, State.C_RR] = c_rr * (1.0 + mean[State.ROLL_COLD] * cold)
    matrix[State.C_RR, State.ROLL_COLD] = c_rr * mean[State.C_RR] * cold
    matrix[State.C_RR, State.ROLL_DRIVE] = c_rr
    matrix[State.C_RR, State.ROLL_START] = c_rr * sums.cold_tyres / max(sums.distance, 1.0)
    offset[State.C_RR] = -c_rr * own
