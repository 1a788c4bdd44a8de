"""The true parameters of a simulated drive, by definition, and cars that have wished ones.

A car with an efficiency map has no single eta. The values that go beside a drive are those with
which the `wheel_power` form of the dynamics, fed with the true wheel power W, spends exactly the
energy that this drive spent, beside what the drivetrain loses by turning. Losses that come with
torque belong to eta and mu:

- eta: sum of W over sum of (W + load loss), both where W > 0;
- mu: sum of (-W - friction - load loss) over sum of (-W), both where W < 0. What the friction
  brakes take counts as not recovered, so mu depends on how the car was driven;
- p_aux: the standing load, the mean of the auxiliary load over the whole drive;
- c_rr: work lost in the tyres over (m g cos(grade) times distance);
- mass, c_d: those of the car; wind counts as a disturbance, not as drag of the car.

W holds the true drag, rolling, grade and inertia including that of rotating parts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from evpinn_ros.simulation.car import Car, Trace, drive_car
from evpinn_ros.simulation.drive import IntervalMotion
from evpinn_ros.simulation.surroundings import Surroundings
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.identifiable import Identifiable, identifiable
from evpinn_ros.vehicle.parameters import LIMITS, PARAMETER_NAMES, Parameters
from evpinn_ros.vehicle.physics import GRAVITY

PLAUSIBLE_ETA = (0.85, 0.92)
PLAUSIBLE_MU = (0.70, 0.82)
PLAUSIBLE_SPREAD = 1.5  # prior sigmas within which the other parameters are drawn

LEAST_AUXILIARY = 50.0  # W, no car draws less

DEFINITIONS: Mapping[str, str] = {
    "eta": "wheel energy / (wheel energy + load losses), while wheel power > 0",
    "mu": "1 - (friction brakes + load losses) / braking energy at the wheels, while braking",
    "mass": "kg, with everyone and everything in the car",
    "c_rr": "work of rolling resistance / (weight on the road * distance)",
    "c_d": "of the car; wind is a disturbance",
    "p_aux": "mean of the auxiliary load over the drive, W",
}


@dataclass(frozen=True, slots=True)
class Truth:
    """True parameters of one drive and what the data alone can determine of them."""

    parameters: Parameters
    identifiable: Identifiable


def true_values(car: Car, trace: Trace) -> Truth:
    """The parameters of `car` on this drive, as the module defines them.

    A drive without driving has eta 1, one without braking mu 0, one that stands the car's c_rr.
    """
    motion, wheel = trace.motion, trace.wheel_power
    driving, braking = wheel > 0, wheel < 0
    output = _total(wheel, driving)
    heat = trace.friction_power + trace.load_loss
    offered = -_total(wheel, braking)
    load = float(np.sum(car.mass * GRAVITY * np.cos(motion.grade) * motion.speed))
    parameters = Parameters(
        eta=output / (output + _total(trace.load_loss, driving)) if output else 1.0,
        mu=1 - _total(heat, braking) / offered if offered else 0.0,
        mass=car.mass,
        c_rr=float(np.sum(trace.rolling_power)) / load if load else car.c_rr,
        c_d=car.c_d,
        p_aux=float(np.mean(trace.auxiliary)),
    )
    return Truth(parameters, identifiable(parameters, car.frontal_area))


def _total(power: np.ndarray, where: np.ndarray) -> float:
    return float(np.sum(power[where]))


def plausible_parameters(vehicle: Vehicle, rng: np.random.Generator) -> Parameters:
    """Parameters a real car could have.

    Mass, c_rr, c_d and p_aux within PLAUSIBLE_SPREAD sigmas of their priors; eta and mu of a
    modern drivetrain, whatever the priors say (the paper's 0.7 and 0.5 are low).
    """
    drawn = _draw(vehicle, rng, PLAUSIBLE_SPREAD)
    return drawn._replace(eta=rng.uniform(*PLAUSIBLE_ETA), mu=rng.uniform(*PLAUSIBLE_MU))


def prior_parameters(vehicle: Vehicle, rng: np.random.Generator) -> Parameters:
    """All six drawn from the vehicle's priors: what makes intervals testable for coverage."""
    return _draw(vehicle, rng, np.inf)


def _draw(vehicle: Vehicle, rng: np.random.Generator, spread: float) -> Parameters:
    """Normal values, drawn anew until inside the limits and within `spread` sigmas."""

    def value(name: str) -> float:
        prior, limits = vehicle.priors[name], LIMITS[name]
        while True:
            drawn = float(rng.normal(prior.value, prior.std))
            near = abs(drawn - prior.value) <= spread * prior.std
            if near and limits.lower < drawn < limits.upper:
                return drawn

    return Parameters(*(value(name) for name in PARAMETER_NAMES))


def tuned(car: Car, motion: IntervalMotion, around: Surroundings, wish: Parameters) -> Car:
    """The car whose true values on this drive are `wish`; mass and c_d are taken as they are.

    Two wishes may be more than a car can do: mu, when even without friction brakes less comes
    back (none are used then but for the limits of `Brakes`), and a p_aux below
    LEAST_AUXILIARY. `true_values` tells what came of it.
    """
    plain = true_values(car, drive_car(car, motion, around)).parameters
    car = replace(car, c_rr=car.c_rr * wish.c_rr / plain.c_rr)
    trace = drive_car(car, motion, around)
    driving = trace.wheel_power > 0
    output, loss = _total(trace.wheel_power, driving), _total(trace.load_loss, driving)
    scale = output * (1 / wish.eta - 1) / loss if loss else 1.0  # load loss is linear in it
    car = replace(
        car,
        drivetrain=replace(car.drivetrain, load_scale=car.drivetrain.load_scale * scale),
        mean_auxiliary=max(wish.p_aux, LEAST_AUXILIARY),
    )
    return _with_recovery(car, motion, around, wish.mu)


def _with_recovery(car: Car, motion: IntervalMotion, around: Surroundings, mu: float) -> Car:
    """The car with the share of the motor in braking that gives this mu, or as near as it can."""

    def with_share(share: float) -> Car:
        return replace(car, brakes=replace(car.brakes, motor_share=share))

    def excess(share: float) -> float:
        candidate = with_share(share)
        recovered = true_values(candidate, drive_car(candidate, motion, around)).parameters.mu
        return float(recovered - mu)

    if excess(1.0) <= 0:
        return with_share(1.0)
    return with_share(float(brentq(excess, 0.0, 1.0, xtol=1e-9)))
