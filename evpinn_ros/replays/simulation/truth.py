"""Definition of the true parameters of a simulated drive, and cars with given true parameters.

A car with an efficiency map has no single eta. Its true values are the least-squares fit of eq. 21
to the energy of its steps, by the method of the estimator (`estimation.published.project`). So
losses due to torque and friction brakes belong to eta and mu, losses without torque to C_rr and
C_d. Wind is a disturbance, mass is that of the car, p_aux the mean auxiliary load.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from evpinn_ros.core.estimation.published import project
from evpinn_ros.core.estimation.states import PHYSICS
from evpinn_ros.core.estimation.terms import Equation, Wheels
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.identifiable import Identifiable, identifiable
from evpinn_ros.core.vehicle.parameters import LIMITS, PARAMETER_NAMES, Parameters
from evpinn_ros.replays.simulation.car import STEP, Car, Trace, drive_car
from evpinn_ros.replays.simulation.drive import IntervalMotion
from evpinn_ros.replays.simulation.surroundings import Surroundings

TRUTH_STEP = 1.0  # s of a step of the definition
ROUNDS = 3  # of tuning a car: one parameter moves another by 1 % of its own change
PLAUSIBLE_ETA = (0.85, 0.92)
PLAUSIBLE_MU = (0.70, 0.82)
PLAUSIBLE_SPREAD = 1.5  # prior sigmas, limit of the other random parameters

LEAST_AUXILIARY = 50.0  # W, no car draws less

DEFINITIONS: Mapping[str, str] = {
    "eta": "mass / (m/eta of the projection on eq. 21)",
    "mu": "(eta mu of the projection) / eta, friction brakes counted as lost",
    "mass": "kg, with everyone and everything in the car",
    "c_rr": "of the projection; an idle drivetrain belongs to it",
    "c_d": "of the projection; wind is a disturbance",
    "p_aux": "mean of the auxiliary load over the drive, W",
}


@dataclass(frozen=True, slots=True)
class Truth:
    """True parameters of one drive, and their identifiable combinations."""

    parameters: Parameters
    identifiable: Identifiable


def true_values(car: Car, trace: Trace, equation: Equation) -> Truth:
    """The parameters of `car` on this drive, as the module defines them."""
    wheels, duration, energy = _steps(car, trace, equation)
    sums = combinations(equation, wheels, duration, energy)
    mass, rolling, drag = (
        sums[name] for name in ("mass_over_eta", "rolling_over_eta", "drag_area_over_eta")
    )
    eta = car.mass / mass
    parameters = Parameters(
        eta=eta,
        mu=sums["regeneration"] / eta,
        mass=car.mass,
        c_rr=rolling / mass,
        c_d=drag * eta / car.frontal_area,
        p_aux=float(np.mean(trace.auxiliary)),
    )
    return Truth(parameters, identifiable(parameters, car.frontal_area))


def combinations(
    equation: Equation, wheels: Wheels, duration: np.ndarray, energy: np.ndarray
) -> dict[str, float]:
    """True combinations of a car by its steps' energy, J, without noise and standing load.

    Directions that the steps do not determine come from the vehicle file.
    """
    terms = np.asarray(wheels.terms)
    prior = equation.mean[PHYSICS]
    over = (terms / duration[:, None]).T
    change = project(over @ terms, over @ (energy - terms @ prior)[:, None], equation)
    drag, rolling, mass, back = (prior + change[:, 0]).tolist()
    braking = 1.0 - wheels.driving
    moved = wheels.drag, wheels.rolling, wheels.inertia + wheels.climb
    braked = np.array([float(braking @ energies) for energies in moved])
    before = float(braked @ equation.mean[PHYSICS[:3]])
    share = before / float(braked @ (drag, rolling, mass)) if before else 1.0
    return {
        "mass_over_eta": mass,
        "regeneration": equation.back + share * back,
        "rolling_over_eta": rolling,
        "drag_area_over_eta": drag,
    }


def _steps(car: Car, trace: Trace, equation: Equation) -> tuple[Wheels, np.ndarray, np.ndarray]:
    """Steps of `TRUTH_STEP`: wheel terms, s, and energy without standing load, J, (n,) each."""
    count = round(TRUTH_STEP / STEP)
    motion = trace.motion
    whole = len(motion.speed) // count * count

    def total(power: np.ndarray) -> np.ndarray:
        return np.asarray(power[:whole].reshape(-1, count).sum(1) * STEP)

    speed = motion.speed
    duration = np.full(whole // count, TRUTH_STEP)
    wheels = equation.wheels(
        duration=duration,
        distance=total(speed),
        air=total(speed**3),
        kinetic=total(speed * motion.acceleration),
        climb=total(speed * np.sin(motion.grade)),
        density=car.air_density,
    )
    return wheels, duration, total(trace.power - trace.auxiliary)


def plausible_parameters(vehicle: Vehicle, rng: np.random.Generator) -> Parameters:
    """Random parameters of a real car: near the priors, with eta and mu of present cars."""
    drawn = _draw(vehicle, rng, PLAUSIBLE_SPREAD)
    return drawn._replace(eta=rng.uniform(*PLAUSIBLE_ETA), mu=rng.uniform(*PLAUSIBLE_MU))


def prior_parameters(vehicle: Vehicle, rng: np.random.Generator) -> Parameters:
    """All six parameters drawn from the vehicle's priors, to test the coverage of intervals."""
    return _draw(vehicle, rng, np.inf)


def _draw(vehicle: Vehicle, rng: np.random.Generator, spread: float) -> Parameters:
    """Normal values, drawn again until inside the limits and within `spread` sigmas."""

    def value(name: str) -> float:
        prior, limits = vehicle.priors[name], LIMITS[name]
        while True:
            drawn = float(rng.normal(prior.value, prior.std))
            near = abs(drawn - prior.value) <= spread * prior.std
            if near and limits.lower < drawn < limits.upper:
                return drawn

    return Parameters(*(value(name) for name in PARAMETER_NAMES))


def tuned(
    car: Car, motion: IntervalMotion, around: Surroundings, wish: Parameters, equation: Equation
) -> Car:
    """A car whose true values are `wish`, as far as brakes and LEAST_AUXILIARY allow."""
    car = replace(car, mean_auxiliary=max(wish.p_aux, LEAST_AUXILIARY))
    for _ in range(ROUNDS):
        plain = true_values(car, drive_car(car, motion, around), equation).parameters
        # A short drive does not determine eta, so the wanted value may be unreachable.
        scale = np.clip((1.0 / wish.eta - 1.0) / max(1.0 / plain.eta - 1.0, 1e-3), 0.5, 2.0)
        drivetrain = car.drivetrain
        car = replace(
            car,
            c_rr=float(np.clip(car.c_rr + wish.c_rr - plain.c_rr, 0.5 * car.c_rr, 2 * car.c_rr)),
            drivetrain=replace(drivetrain, load_scale=drivetrain.load_scale * float(scale)),
        )
        car = _with_recovery(car, motion, around, wish.mu, equation)
    return car


def _with_recovery(
    car: Car, motion: IntervalMotion, around: Surroundings, mu: float, equation: Equation
) -> Car:
    """The car with the motor's share of braking that gives this mu, as near as possible."""

    def with_share(share: float) -> Car:
        return replace(car, brakes=replace(car.brakes, motor_share=share))

    def excess(share: float) -> float:
        candidate = with_share(share)
        trace = drive_car(candidate, motion, around)
        return float(true_values(candidate, trace, equation).parameters.mu - mu)

    if excess(1.0) <= 0:
        return with_share(1.0)
    if excess(0.0) >= 0:
        return with_share(0.0)
    return with_share(float(brentq(excess, 0.0, 1.0, xtol=1e-4)))
