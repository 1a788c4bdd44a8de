"""The one equation: battery energy of a step of driving, as terms times states.

With the wheel energy of a step over eta, by the states of `estimation.states` (u: flow of the
air, ROLLING' with the cold, the start and the offset of this drive),

    t = DRAG_AREA_OVER_ETA rho/2 int u|u| v dt + ROLLING' g ds
        + MASS_OVER_ETA (k d(v^2/2) + g dh),

the battery gives

    E = t                              where the prior car drives (its t > 0),
      = eta mu t + REGEN_DELTA t_prior where it brakes, eta mu of the prior,
      + FORCE_SQUARED int f^2 dt + TURNING int (1 + v / 10 m/s) / 2 dt
      + int v N(v, f) dt               the network (`estimation.network`),
      + loads dt                       standing, heating and cooling, wandering.

This is eq. 12-21 in the weak form: kinetic and potential energy are exact differences, so a step
may be of any length and no derivative is needed. It is linear in the states, for which step drives
and which brakes is decided by the prior car; that was measured to lose nothing. Where the motor's
torque is reported its energy stands in for t.

Learning, prediction, dropouts, the breakdown, forecasts of plans and the truth of simulated cars
all use `rows`; `split` divides the same rows by where the energy goes. Nothing else knows the
physics.
"""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.arrays import chosen_rows, like, namespace, numbers, within, zeros
from evpinn_ros.core.estimation.network import (
    orthogonal_network,
    reference_driving,
    share_of_terms,
)
from evpinn_ros.core.estimation.states import PHYSICS, SIZE, WEIGHTS, Duration, State, prior_of
from evpinn_ros.core.signals.interval import Steps
from evpinn_ros.core.signals.road import Conditions
from evpinn_ros.core.signals.sample import Sample, Samples
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.physics import GRAVITY

CREEPING = 0.3  # m/s, below which the drivetrain stands
TURNING_SPEED = 10.0  # m/s, at which the loss of turning equals its state
MOST_FORCE = 4.0  # m/s^2, force over mass; tyres give no more
LEAST_STEP = 0.5  # m; shorter steps do not resolve the force
MILD_CELSIUS = 20.0  # neither heated nor cooled
TYRES_WARM, CABIN_WARM = 1200.0, 600.0  # s, time constants of warming up
# s, of cooling down: before a test a passenger car's tyre stands for three hours (ISO 28580).
COOLED = 3600.0
HEATING = [State.COLD, State.HOT, State.COLD_START, State.HOT_START]  # and cooling
CLIMATE = [*HEATING, State.REPORTED]
NETWORK_WEIGHTS = range(WEIGHTS.start, WEIGHTS.stop)
# Beside eq. 21; an array, because converting a list of states takes 30 us.
EXPLAINED = np.array([State.FORCE_SQUARED, *NETWORK_WEIGHTS])
STANDING_LOADS = [State.P_AUX, State.LOAD_DRIVE, State.LOAD]
TYRES = [State.ROLLING_COLD, State.ROLLING_START, State.ROLLING_DRIVE]  # of rolling
LOAD = [State.MASS_DRIVE, State.LOSS_DRIVE]  # of one drive
WHEELS = [*PHYSICS, *TYRES, *LOAD]  # that the motor's energy stands in for
MOTOR = [State.MOTOR_DRIVE, State.MOTOR_BRAKE, State.MOTOR_RATIO]
# Terms of moving beside eq. 21: every state of the car that is in no other list.
LISTED = {*WHEELS, *MOTOR, *CLIMATE, *STANDING_LOADS, State.ETA}
BESIDE = [
    *(state for state in State if state.level is Duration.CAR and state not in LISTED),
    *NETWORK_WEIGHTS,
]


class Part(IntEnum):
    """Index of a part of the energy. All but the last add up to the whole."""

    AIR = 0
    TYRES = 1
    SLOPE = 2  # net
    SPEED = 3  # net: kinetic energy at the end less that at the start
    BRAKES = 4  # lost while braking, in brakes and drivetrain
    DRIVETRAIN = 5  # lost while driving, and by turning
    CLIMATE = 6
    STANDING = 7
    REGAINED = 8  # by braking, at the battery; not in the sum, because it was not lost


COUNT = len(Part)
WHOLE = slice(0, Part.REGAINED)  # the parts that add up
# Parts that are never negative; air may push, a road may fall, a car may slow down.
LOSSES = Part.TYRES, Part.BRAKES, Part.DRIVETRAIN, Part.CLIMATE, Part.STANDING, Part.REGAINED


class Wheels(NamedTuple):
    """Work at the wheels of the prior car in n steps; arrays of shape (n,), numpy or torch.

    Attributes:
        drag: integral of rho/2 u|u| v dt, J per m^2 of A C_d.
        rolling: g times the way, J per kg of C_rr m.
        inertia: kinetic energy gained, J per kg.
        climb: potential energy gained, J per kg.
        energy: of the prior car over eta, J; its sign tells driving from braking.
        driving: 1 where the car drives, 0 where it brakes.
        gain: battery energy per J of `energy`: 1 where it drives, eta mu where it brakes.
        speed: mean, m/s.
        force: of the wheels over the mass, m/s^2.
    """

    drag: Any
    rolling: Any
    inertia: Any
    climb: Any
    energy: Any
    driving: Any
    gain: Any
    speed: Any
    force: Any

    @property
    def terms(self) -> Any:
        """The terms of eq. 21 in the order of `states.PHYSICS`, shape (..., n, 4)."""
        return namespace(self.energy).stack(self.columns, -1)

    @property
    def columns(self) -> tuple[Any, ...]:
        """`terms` as a tuple of arrays."""
        gain, braking = self.gain, 1.0 - self.driving
        mass = (self.inertia + self.climb) * gain
        return self.drag * gain, self.rolling * gain, mass, self.energy * braking


class Warmth(NamedTuple):
    """Coldness of tyres and cabin, from 1 at the start of a drive to 0."""

    tyres: Any
    cabin: Any

    @classmethod
    def after(cls, seconds: Any) -> Warmth:
        """Coldness at a time after a start, s."""
        return cls(1.0, 1.0).driven(seconds)

    def driven(self, seconds: Any) -> Warmth:
        """Coldness after more driving, s."""
        exp = namespace(seconds).exp
        return Warmth(
            self.tyres * exp(-seconds / TYRES_WARM), self.cabin * exp(-seconds / CABIN_WARM)
        )

    def during(self, duration: Any) -> Warmth:
        """Mean coldness in each of steps of driving, s, one after another, shape (..., n).

        The mean, not the value in the middle, so that how a trip is cut changes nothing.
        """
        xp = namespace(duration)
        begin = xp.cumsum(duration, -1) - duration

        def mean(cold: Any, warms_in: float) -> Any:
            share = -xp.expm1(-duration / warms_in) * (warms_in / duration)
            return cold * share * xp.exp(-begin / warms_in)

        return Warmth(mean(self.tyres, TYRES_WARM), mean(self.cabin, CABIN_WARM))

    def stood(self, seconds: float) -> Warmth:
        """Coldness after the car has stood for these seconds."""
        left = math.exp(-seconds / COOLED)
        return Warmth(1.0 - (1.0 - self.tyres) * left, 1.0 - (1.0 - self.cabin) * left)


WARM = Warmth(0.0, 0.0)


class Equation:
    """The one equation of a car, about the prior of its vehicle file.

    Attributes:
        vehicle: the vehicle file.
        seed: of the network.
        mean: prior of the states, shape (SIZE,); the terms are linear about it.
        covariance: of that, shape (SIZE, SIZE).
        eta: efficiency of the prior, between battery and wheels.
        back: eta mu of the prior.
        network: of the car.
        explained: what the terms of eq. 21 explain of `EXPLAINED`, shape (4, len(EXPLAINED)).
        reference_gram: mean products of these terms over the reference of driving, shape (4, 4).
    """

    def __init__(self, vehicle: Vehicle, seed: int = 0) -> None:
        """Make `EXPLAINED` orthogonal to the terms of eq. 21; seed: of the network."""
        self.vehicle, self.seed = vehicle, seed
        self.mean, self.covariance = prior_of(vehicle)
        self._prior = self.mean[PHYSICS].tolist()
        self.eta = vehicle.priors["eta"].value
        self.back = self.eta * vehicle.priors["mu"].value
        driving = reference_driving()
        speed = driving.speed
        kinetic, climb = speed * driving.acceleration, speed * driving.slope
        second = np.ones_like(speed)
        wheels = self.wheels(second, speed, speed**3, kinetic, climb, vehicle.air_density)
        terms = wheels.terms
        self.network = orthogonal_network(seed, driving, wheels.force, terms)
        squared = wheels.force[:, None] ** 2 * (speed > CREEPING)[:, None]
        self.explained = np.hstack(
            (share_of_terms(driving, terms, squared), self.network.explained)
        )
        self.reference_gram = (driving.seconds / driving.seconds.sum() * terms.T) @ terms

    def wheels(
        self, duration: Any, distance: Any, air: Any, kinetic: Any, climb: Any, density: Any
    ) -> Wheels:
        """Work of the prior car in steps of one shape, as in `Steps`; density of air, kg/m^3."""
        way = abs(distance)
        drag, rolling = 0.5 * density * air, GRAVITY * way
        inertia, height = self.vehicle.rotating_mass_factor * kinetic, GRAVITY * climb
        area, c_rr_mass, mass, _ = self._prior
        energy = area * drag + c_rr_mass * rolling + mass * (inertia + height)
        driving = numbers(energy > 0.0, energy)
        least = within(way, LEAST_STEP, math.inf)
        force = within(energy / (mass * least), -MOST_FORCE, MOST_FORCE)
        gain = driving + (1.0 - driving) * self.back
        speed = way / duration
        return Wheels(drag, rolling, inertia, height, energy, driving, gain, speed, force)

    def rows(
        self, steps: Steps, conditions: Conditions, warmth: Warmth, wheels: Wheels | None = None
    ) -> np.ndarray:
        """Energy of each step by each state, J per unit, shape (n, SIZE).

        Args:
            steps: n of them, or one, of numbers, whose row has shape (SIZE,).
            conditions: of all of them.
            warmth: of tyres and cabin.
            wheels: `of_steps`, if already computed.
        """
        wheels = wheels or self.of_steps(steps, conditions)
        cold = coldness(conditions.celsius)
        rows = self.moving_rows(wheels, steps.duration, cold, warmth.tyres)
        columns: dict[State, Any] = {}
        if steps.motor_known:
            rows[..., WHEELS] = 0.0
            columns = self._motor_columns(steps)
        for state, power in standing_powers(conditions, warmth).items():
            columns[state] = power * steps.duration
        for state, column in columns.items():
            rows[..., state] = column
        return np.asarray(rows)

    def moving_rows(self, wheels: Wheels, duration: Any, cold: Any, tyres: Any) -> Any:
        """Rows of moving the car, without loads: shape (..., n, SIZE), numpy or torch.

        Args:
            wheels: of the steps, shape (..., n).
            duration: s, of the same shape.
            cold: tens of K below a mild day, a number or of that shape.
            tyres: coldness of the tyres, a number or of that shape.
        """
        rows = zeros((*wheels.energy.shape, SIZE), wheels.energy)
        for state, column in self.moving_columns(wheels, duration, cold, tyres).items():
            rows[..., state] = column
        terms = rows[..., PHYSICS]
        force = self.network.force(wheels.speed, wheels.force)
        rows[..., WEIGHTS] = (wheels.rolling * (1.0 / GRAVITY))[..., None] * force
        rows[..., EXPLAINED] -= terms @ like(self.explained, terms)
        return rows

    def moving_columns(
        self, wheels: Wheels, duration: Any, cold: Any, tyres: Any
    ) -> dict[State, Any]:
        """Columns of `moving_rows` by state, without the network, of the steps' shape.

        Those of `EXPLAINED` still contain their share of the terms of eq. 21, which is these terms
        times `explained`, for steps and for sums.
        """
        turns = numbers(wheels.speed > CREEPING, duration) * duration
        columns = dict(zip(PHYSICS, wheels.columns, strict=True))
        _, rolling, mass, _ = self._prior
        prior = rolling * columns[State.ROLLING]
        return columns | {
            State.FORCE_SQUARED: wheels.force**2 * turns,
            State.TURNING: turns * (0.5 + (0.5 / TURNING_SPEED) * wheels.speed),
            State.ROLLING_COLD: prior * cold,
            State.ROLLING_START: prior * tyres,
            State.ROLLING_DRIVE: prior,
            # Tyres carry the load too.
            State.MASS_DRIVE: columns[State.MASS_OVER_ETA] + prior * (1.0 / mass),
            State.LOSS_DRIVE: abs(wheels.energy) * wheels.gain,
        }

    def split(self, rows: np.ndarray, wheels: Wheels, cold: float, tyres: Any) -> np.ndarray:
        """Energy of n steps together by part and state, J per unit, shape (COUNT, SIZE).

        Those of `WHOLE` add up to `rows`. Air, tyres, slope and speed are work at the wheels, and
        give back what they took. Losses on the way are the drivetrain's while the car drives, and
        the brakes' while it brakes, except that of turning. ETA divides the same energy between
        wheels and drivetrain, so the whole does not depend on it.

        Args:
            rows: of the steps, as `rows` has them, shape (n, SIZE).
            wheels: of the steps.
            cold: tens of K below a mild day.
            tyres: coldness of the tyres, a number or of shape (n,).
        """
        parts, by_step = np.zeros((COUNT, SIZE)), np.zeros((4, *rows.shape))
        rolling = float(self.mean[State.ROLLING]) * wheels.rolling
        by_step[Part.AIR, :, State.DRAG_AREA_OVER_ETA] = wheels.drag
        by_step[Part.TYRES, :, State.ROLLING] = wheels.rolling
        by_step[Part.TYRES, :, State.ROLLING_COLD] = rolling * cold
        by_step[Part.TYRES, :, State.ROLLING_START] = rolling * tyres
        by_step[Part.TYRES, :, State.ROLLING_DRIVE] = rolling
        by_step[Part.TYRES, :, State.MASS_DRIVE] = rolling / float(self.mean[State.MASS_OVER_ETA])
        for mass in (State.MASS_OVER_ETA, State.MASS_DRIVE):
            by_step[Part.SLOPE, :, mass] = wheels.climb
            by_step[Part.SPEED, :, mass] = wheels.inertia
        prior = np.zeros(SIZE)
        prior[PHYSICS[:3]] = self.mean[PHYSICS[:3]]
        by_step *= self.eta
        by_step[..., State.ETA] = by_step @ prior / self.eta
        parts[:4] = by_step.sum(1)
        moving = rows.copy()
        moving[:, CLIMATE + STANDING_LOADS] = 0.0
        back = self._braked(moving, wheels)
        lost = moving.sum(0) - parts[:4].sum(0)
        parts[Part.BRAKES] = back - (1.0 - wheels.driving) @ by_step.sum(0)
        parts[Part.DRIVETRAIN] = lost - parts[Part.BRAKES]
        parts[Part.REGAINED] = -back
        parts[Part.CLIMATE, CLIMATE] = rows[:, CLIMATE].sum(0)
        parts[Part.STANDING, STANDING_LOADS] = rows[:, STANDING_LOADS].sum(0)
        return parts

    def _braked(self, moving: np.ndarray, wheels: Wheels) -> np.ndarray:
        """Energy of moving the car by state while it brakes, J per unit, shape (SIZE,).

        Where the motor's torque is known, its sign shows braking: its reports lag by some 0.1 s,
        so the steps in which the prior car brakes hold some of the energy of driving.
        """
        back = (1.0 - wheels.driving) @ moving
        back[State.TURNING] = 0.0
        back[State.MOTOR_DRIVE] = 0.0
        back[State.MOTOR_BRAKE] = moving[:, State.MOTOR_BRAKE].sum()
        if moving[:, State.MOTOR_RATIO].any():
            back[State.MOTOR_RATIO] = self.mean[State.MOTOR_BRAKE] * back[State.MOTOR_BRAKE]
        return np.asarray(back)

    def motor_rows(
        self, steps: Steps, conditions: Conditions, warmth: Warmth, wheels: Wheels
    ) -> np.ndarray:
        """Energy at the wheels less that of the motor, driving and braking, shape (2, SIZE).

        Each is zero, up to noise, so reported torque measures the wheels without the battery.
        Torque does not show the share of friction brakes.
        """
        cold, apart = coldness(conditions.celsius), np.zeros((len(steps.duration), SIZE))
        moving = self.moving_columns(wheels, steps.duration, cold, warmth.tyres)
        for state in WHEELS:
            if state is not State.LOSS_DRIVE:  # no drive learns it
                apart[:, state] = moving[state]
        for state, column in self._motor_columns(steps).items():
            apart[:, state] = -column
        # An unseen climb is work of the wheels too, all along the way.
        apart[:, State.CLIMB] = np.abs(steps.distance) / max(np.abs(steps.distance).sum(), 1e-9)
        return np.stack((wheels.driving @ apart, (1.0 - wheels.driving) @ apart))

    def rows_of(self, samples: Samples, warmth: Warmth) -> np.ndarray:
        """Power at n samples by each state, W per unit, shape (n, SIZE): the energy of 1 s."""
        return self.rows_along(moved_of(samples), samples, warmth)

    def row_of(self, sample: Sample, warmth: Warmth) -> np.ndarray:
        """`rows_of` of one sample, shape (SIZE,), without arrays of one row."""
        steps = Steps._make((*moved_of(sample), sample.motor_scaled))
        return self.rows(steps, conditions_of(sample), warmth)

    def rows_along(
        self, moved: tuple[np.ndarray, ...], samples: Samples, warmth: Warmth
    ) -> np.ndarray:
        """Energy of n steps by each state, J per unit, shape (n, SIZE).

        Args:
            moved: columns of `Steps`, shape (n,) each.
            samples: the ends of the steps.
            warmth: of tyres and cabin.
        """
        conditions = conditions_of(samples)
        if np.isnan(samples.motor_power).all():
            return self.rows(Steps._make((*moved, True)), conditions, warmth)
        motor, rows = motor_of(samples), np.empty((samples.size, SIZE))
        for kind in np.unique(motor).tolist():
            chosen = motor == kind
            steps = Steps._make((*(c[chosen] for c in moved), kind != Motor.UNSCALED))
            rows[chosen] = self.rows(steps, chosen_rows(conditions, chosen), warmth)
        return rows

    def of_steps(self, steps: Steps, conditions: Conditions) -> Wheels:
        """`wheels` of steps and their conditions."""
        return self.wheels(*steps[:5], conditions.air_density)

    def _motor_columns(self, steps: Steps) -> dict[State, Any]:
        """Columns of the motor's energy, which replaces the work of the wheels."""
        drive, brake = steps.motor_drive, -steps.motor_brake
        columns = {State.MOTOR_DRIVE: drive, State.MOTOR_BRAKE: brake}
        if not steps.motor_scaled:
            prior = self.mean[[State.MOTOR_DRIVE, State.MOTOR_BRAKE]]
            columns[State.MOTOR_RATIO] = prior[0] * drive + prior[1] * brake
        return columns


def standing_powers(conditions: Conditions, warmth: Warmth) -> dict[State, Any]:
    """Standing power by state, W per unit; other states have none."""
    powers = dict.fromkeys(STANDING_LOADS, 1.0)
    known = conditions.load_known
    climate = climate_powers(conditions.celsius, warmth)
    if known is False:
        return powers | climate
    powers |= {State.REPORTED: conditions.load}
    if known is True:
        return powers
    return powers | {state: power * ~known for state, power in climate.items()}


def climate_powers(celsius: Any, warmth: Warmth) -> dict[State, Any]:
    """Heating and cooling by state, W per unit; an unknown temperature is that of a mild day.

    The temperature is a number, or an array of them.
    """
    if celsius is None:
        return {}
    away = abs(celsius - MILD_CELSIUS)
    cold, hot = away * (celsius < MILD_CELSIUS), away * (celsius > MILD_CELSIUS)
    return {
        State.COLD: cold,
        State.COLD_START: cold * warmth.cabin,
        State.HOT: hot,
        State.HOT_START: hot * warmth.cabin,
    }


class Motor(IntEnum):
    """Knowledge of the motor's power at a sample."""

    UNKNOWN = 0
    UNSCALED = 1  # up to a factor: the gear ratio is unknown
    KNOWN = 2


def motor_of(samples: Samples) -> np.ndarray:
    """Knowledge of the motor's power at each sample (`Motor`), shape (n,)."""
    known = np.where(samples.motor_scaled, Motor.KNOWN, Motor.UNSCALED)
    return np.where(np.isnan(samples.motor_power), Motor.UNKNOWN, known)


@lru_cache(maxsize=16)
def equation_of(vehicle: Vehicle, seed: int = 0) -> Equation:
    """The equation of a car; cached, because making one takes 50 ms."""
    return Equation(vehicle, seed)


def coldness(celsius: Any) -> Any:
    """Tens of K below a mild day, of a temperature or an array of them."""
    below = 0.0 if celsius is None else MILD_CELSIUS - celsius
    return below * (below > 0.0) / 10.0


def moved_of(samples: Samples | Sample) -> tuple[Any, ...]:
    """Steps of 1 s at samples, or at one: columns of `Steps` up to `motor_brake`."""
    v = np.abs(samples.speed)
    flow = v + samples.head_wind
    kinetic = samples.speed * samples.acceleration
    climb = samples.speed * np.sin(samples.grade)
    power = samples.motor_power
    drive, brake = np.maximum(power, 0.0), np.maximum(np.negative(power), 0.0)
    return np.ones_like(v), v, flow * np.abs(flow) * v, kinetic, climb, drive, brake


def conditions_of(samples: Samples | Sample) -> Conditions:
    """Surroundings of samples, or of one; an unknown temperature is that of a mild day."""
    celsius = np.where(np.isnan(samples.celsius), MILD_CELSIUS, samples.celsius)[()]
    load = samples.known_auxiliary
    return Conditions(samples.air_density, samples.head_wind, celsius, load, load > 0.0)
