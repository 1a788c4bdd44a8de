"""Battery energy of some seconds of driving, and its gradient: eq. 12-21 integrated.

Each step of an interval spends, with wheel energy

    T = m (k d(v^2/2) + g (dh + climb)) + m g C_rr' ds + rho A C_d integral(u|u| v dt) / 2
        + m g force ds,                      C_rr' the rolling resistance of this drive,

T / eta where T > 0 and mu T where T < 0, and beside it the loss of a drivetrain that turns, that
of force squared, and the standing load. Recuperation fades out below `FADE_SPEED`. Where the bus
reports motor torque, the motor's energy stands in for T / (what the gears lose), and T is itself
measured by it. Instantaneous power is the energy of one step of 1 s, so there is one equation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.estimation.car_state import MILD_CELSIUS, SIZE, State
from evpinn_ros.signals.interval import Steps
from evpinn_ros.signals.road import Conditions
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.linear_power import CREEPING, FADE_END, FADE_SPEED, MOST_FORCE, turning
from evpinn_ros.vehicle.physics import GRAVITY

LEAST_STEP = 0.5  # m, over less the force is not resolved
CLIMATE = slice(State.COLD, State.REPORTED + 1)  # states of heating and cooling
STANDING = [State.P_AUX, State.AUX_DRIVE, State.AUX]  # and of all other standing load


class Constants(NamedTuple):
    """Constants of a car that are not learned: m^2, 1, and the C_rr of which C_RR is a share."""

    frontal_area: float
    rotating_mass_factor: float
    c_rr: float

    @classmethod
    def of(cls, vehicle: Vehicle) -> Constants:
        """Those of a vehicle file."""
        return cls(
            vehicle.frontal_area, vehicle.rotating_mass_factor, vehicle.priors["c_rr"].value
        )


class Warmth(NamedTuple):
    """Coldness of tyres and cabin, from 1 at the start of a drive to 0."""

    tyres: float
    cabin: float


class Wheels(NamedTuple):
    """Energy at the wheels by step, shape (K, n), its parts, and what one unit costs."""

    total: np.ndarray
    drag: np.ndarray
    weight: np.ndarray  # m g
    driving: np.ndarray
    fade: np.ndarray  # shape (n,)
    square: np.ndarray  # (force / mass)^2 dt


@dataclass(frozen=True, eq=False)
class Spent:
    """Battery energy of an interval for each of K hypotheses.

    What samples need is computed at once, all else where it is asked for.

    Attributes:
        energy: J, shape (K,).
        gradient: by the states, shape (K, SIZE).
        traction: of it by step, or driving and braking where the motor is known, J.
        wheels: energy at the wheels.
    """

    energy: np.ndarray
    gradient: np.ndarray
    traction: np.ndarray
    wheels: Wheels

    @cached_property
    def throughput(self) -> np.ndarray:
        """Sum of the size of what drives and brakes, J, shape (K,)."""
        return np.asarray(np.abs(self.traction).sum(1))

    @cached_property
    def wheel_drive(self) -> np.ndarray:
        """Energy of the wheels where they drive, J, shape (K,)."""
        return _where(self.wheels.total, self.wheels.driving)

    @cached_property
    def wheel_brake(self) -> np.ndarray:
        """Energy of the wheels where they brake, positive J, shape (K,)."""
        return -_where(self.wheels.total, ~self.wheels.driving)

    @cached_property
    def force_drive(self) -> np.ndarray:
        """Integral of (force over mass)^2 where they drive, m^2/s^3, shape (K,)."""
        return _where(self.wheels.square, self.wheels.driving)

    @cached_property
    def force_brake(self) -> np.ndarray:
        """Integral of (force over mass)^2 where they brake, m^2/s^3, shape (K,)."""
        return _where(self.wheels.square, ~self.wheels.driving)

    @cached_property
    def recovered(self) -> np.ndarray:
        """Share of the braking energy that recuperation can take, shape (K,)."""
        faded = -_where(self.wheels.total * self.wheels.fade, ~self.wheels.driving)
        return np.asarray(faded / np.maximum(self.wheel_brake, 1.0))


def spent(
    mean: np.ndarray, steps: Steps, conditions: Conditions, warmth: Warmth, car: Constants
) -> Spent:
    """Battery energy of the steps of an interval.

    Args:
        mean: states, shape (K, SIZE).
        steps: n of them.
        conditions: of the interval.
        warmth: of tyres and cabin.
        car: constants.
    """
    wheels = wheels_at(mean, steps, conditions, warmth, car)
    eta, mu = (np.exp(mean[:, i])[:, None] for i in (State.ETA, State.MU))
    rate = np.where(wheels.driving, 1.0 / eta, mu * wheels.fade)
    traction = rate * wheels.total
    gradient = np.zeros((len(mean), SIZE))
    gradient[:, State.ETA] = -_where(traction, wheels.driving)
    gradient[:, State.MU] = _where(traction, ~wheels.driving)
    gradient[:, State.MASS] = (rate * (wheels.total - wheels.drag)).sum(1)
    gradient[:, State.C_D] = (rate * wheels.drag).sum(1)
    if steps.motor_known:
        traction = by_motor(mean, steps, gradient)
        gradient[:, : State.C_RR] = 0.0
        gradient[:, State.C_D] = 0.0
        gradient[:, State.ETA] = gradient[:, State.TORQUE]
        rate = np.zeros_like(rate)
    rolling_gradient(gradient, mean, rate * wheels.weight, steps, conditions, warmth, car)
    rest = standing(mean, steps, conditions, warmth, gradient)
    turned = float(steps.duration @ turning(steps.distance / steps.duration))
    gradient[:, State.NO_LOAD] = turned
    gradient[:, State.COPPER] = square = wheels.square.sum(1)
    loss = mean[:, State.NO_LOAD] * turned + mean[:, State.COPPER] * square
    return Spent(traction.sum(1) + loss + rest, gradient, traction, wheels)


def motor_energy(
    mean: np.ndarray, steps: Steps, conditions: Conditions, warmth: Warmth, car: Constants
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Energy of the motor where it drives, and where it brakes, J, each with its gradient."""
    wheels = wheels_at(mean, steps, conditions, warmth, car)
    share = np.exp(mean[:, State.TORQUE])[:, None]
    back = np.exp(mean[:, State.MU] - mean[:, State.GENERATOR])[:, None]
    found = []
    for rate, own in (
        (share * wheels.driving, (State.TORQUE,)),
        (-back * wheels.fade * ~wheels.driving, (State.MU,)),
    ):
        energy = (rate * wheels.total).sum(1)
        gradient = np.zeros((len(mean), SIZE))
        for state in own:
            gradient[:, state] = energy
        if State.MU in own:
            gradient[:, State.GENERATOR] = -energy
        gradient[:, State.MASS] = (rate * (wheels.total - wheels.drag)).sum(1)
        gradient[:, State.C_D] = (rate * wheels.drag).sum(1)
        rolling_gradient(gradient, mean, rate * wheels.weight, steps, conditions, warmth, car)
        found.append((energy, gradient))
    return found[0], found[1]


def unit_step(sample: Sample) -> tuple[Steps, Conditions]:
    """A sample as one step of 1 s, so that energy is power."""
    v = abs(sample.speed)
    flow = v + sample.head_wind
    motor = sample.motor_power
    columns = (
        1.0,
        v,
        flow * abs(flow) * v,
        sample.speed * sample.acceleration,
        sample.speed * math.sin(sample.grade),
        np.maximum(motor, 0.0),
        np.maximum(-motor, 0.0),
    )
    conditions = Conditions(
        sample.air_density,
        sample.head_wind,
        sample.celsius,
        sample.known_auxiliary,
        sample.known_auxiliary > 0.0,
    )
    return Steps(*(np.array([column]) for column in columns)), conditions


def wheels_at(
    mean: np.ndarray, steps: Steps, conditions: Conditions, warmth: Warmth, car: Constants
) -> Wheels:
    """Energy at the wheels by step."""
    mass, c_d = (np.exp(mean[:, i])[:, None] for i in (State.MASS, State.C_D))
    weight = mass * GRAVITY
    rolling = car.c_rr * _rolling(mean, conditions, warmth)[:, None]
    length = max(float(steps.distance.sum()), 1e-6)
    climb = steps.climb + mean[:, State.CLIMB][:, None] * (steps.distance / length)
    drag = 0.5 * conditions.air_density * car.frontal_area * c_d * steps.air
    total = (
        mass * car.rotating_mass_factor * steps.kinetic
        + weight * (climb + (rolling + mean[:, State.FORCE][:, None]) * steps.distance)
        + drag
    )
    speed = steps.distance / steps.duration
    force = _within(total / mass / np.maximum(steps.distance, LEAST_STEP), -MOST_FORCE, MOST_FORCE)
    return Wheels(
        total=total,
        drag=drag,
        weight=weight,
        driving=total > 0.0,
        fade=_within((speed - FADE_END) / (FADE_SPEED - FADE_END), 0.0, 1.0),
        square=force**2 * steps.duration * (speed > CREEPING),
    )


def _rolling(mean: np.ndarray, conditions: Conditions, warmth: Warmth) -> np.ndarray:
    """Rolling resistance of this drive over the prior's, shape (K,)."""
    cold = _cold(conditions) / 10.0
    own = mean[:, State.C_RR] * (1.0 + mean[:, State.ROLL_COLD] * cold)
    return np.asarray(own + mean[:, State.ROLL_DRIVE] + mean[:, State.ROLL_START] * warmth.tyres)


def rolling_gradient(
    gradient: np.ndarray,
    mean: np.ndarray,
    rate: np.ndarray,
    steps: Steps,
    conditions: Conditions,
    warmth: Warmth,
    car: Constants,
) -> None:
    """Fill in what the states add that act along the road; `rate` is J per m of it, (K, n)."""
    along = (rate * steps.distance).sum(1)
    cold = _cold(conditions) / 10.0
    gradient[:, State.C_RR] = along * car.c_rr * (1.0 + mean[:, State.ROLL_COLD] * cold)
    gradient[:, State.ROLL_COLD] = along * car.c_rr * mean[:, State.C_RR] * cold
    gradient[:, State.ROLL_DRIVE] = along * car.c_rr
    gradient[:, State.ROLL_START] = along * car.c_rr * warmth.tyres
    gradient[:, State.FORCE] = along
    gradient[:, State.CLIMB] = along / max(float(steps.distance.sum()), 1e-6)


def by_motor(mean: np.ndarray, steps: Steps, gradient: np.ndarray) -> np.ndarray:
    """Traction energy of the battery by that of the motor, J, shape (K, 2); its gradient."""
    drive = np.exp(-mean[:, State.ETA] - mean[:, State.TORQUE]) * steps.motor_drive.sum()
    brake = -np.exp(mean[:, State.GENERATOR]) * steps.motor_brake.sum()
    gradient[:, State.TORQUE] = -drive
    gradient[:, State.GENERATOR] = brake
    return np.stack((drive, brake), axis=1)


def standing(
    mean: np.ndarray,
    steps: Steps,
    conditions: Conditions,
    warmth: Warmth,
    gradient: np.ndarray,
) -> np.ndarray:
    """Energy of the standing load, J, shape (K,); its gradient is filled in.

    A car that reports its heating and cooling has these in the report.
    """
    duration = float(steps.duration.sum())
    cold = 0.0 if conditions.load_known else _cold(conditions)
    hot = 0.0 if conditions.load_known else _hot(conditions)
    heat = cold, hot, cold * warmth.cabin, hot * warmth.cabin, conditions.load
    gradient[:, CLIMATE] = by_heat = duration * np.array(heat)
    own = mean[:, CLIMATE] @ by_heat
    for state in STANDING:
        gradient[:, state] = duration
        own += mean[:, state] * duration
    return np.asarray(own + conditions.load * duration)


def _cold(conditions: Conditions) -> float:
    return 0.0 if conditions.celsius is None else max(0.0, MILD_CELSIUS - conditions.celsius)


def _hot(conditions: Conditions) -> float:
    return 0.0 if conditions.celsius is None else max(0.0, conditions.celsius - MILD_CELSIUS)


def _where(values: np.ndarray, condition: np.ndarray) -> np.ndarray:
    """Sum along the steps where a condition holds."""
    return np.asarray((values * condition).sum(1))


def _within(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """`numpy.clip`, which takes three times as long for a few numbers."""
    return np.asarray(np.minimum(np.maximum(values, low), high))
