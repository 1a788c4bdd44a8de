"""The energy that plans will take, and how sure that is.

`forecast` is for optimisers: many speed profiles at once, whole trips, numpy or torch.
`forecast_plan` is for one plan, or a few, with energy and power at every point.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.arrays import namespace
from evpinn_ros.energy.charge import UNKNOWN, Uncertain
from evpinn_ros.energy.plan import Plan, PlanError
from evpinn_ros.energy.power_model import Motion, PlanEnd, PowerModel, vehicle_model
from evpinn_ros.vehicle.files import Vehicle

SIMPSON = np.array([1.0, 4.0, 1.0]) / 6
FIRST_RESIDUAL = 3000.0  # W, 1-sigma of power around the physics before any was seen
DIRECTION_LENGTH = 5e3  # m within which a trip turns away from where the car now points
UNKNOWN_END = PlanEnd(np.full(1, math.nan), *(np.array(math.nan) for _ in range(3)))
CHUNK = 32  # profiles computed together, so that what they need stays in the cache


class Profiles(NamedTuple):
    """Candidate speed profiles, numpy arrays or torch tensors.

    Attributes:
        time: s, strictly rising, shape (n,) for all alike or (batch, n).
        speed: m/s, not negative, shape (batch, n); linear between its points.
        elevation: m, shape (n,) or (batch, n), None for a flat road.
    """

    time: Any
    speed: Any
    elevation: Any = None


class Energies(NamedTuple):
    """Energy of each profile and its 1-sigma, J, shape (batch,), of the kind that came in."""

    energy: Any
    sigma: Any


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Energy along a plan; all arrays have the plan's shape, (n,) or (batch, n).

    Attributes:
        time: s.
        energy: J since the first point; less than before where the car regenerates.
        power: W at each point, with the acceleration and grade of the leg that follows (at the
            last point: of the leg that ends there).
        sigma: 1-sigma of energy, J.
        end: of the whole plan, what a comparison with another needs.
    """

    time: np.ndarray
    energy: np.ndarray
    power: np.ndarray
    sigma: np.ndarray
    end: PlanEnd = UNKNOWN_END


def forecast(
    profiles: Profiles,
    vehicle: Vehicle,
    model: PowerModel | None = None,
    *,
    air_density: float | None = None,
) -> Energies:
    """Energy of many speed profiles, and its 1-sigma.

    Each leg counts with its mean speed, so legs should last a few seconds at most: kinetic and
    potential energy are exact whatever the legs. With torch the results have gradients by all
    three. Power bends where the car turns from driving to braking, and a learned model jumps a
    little there; the gradient is that of the pieces.

    Args:
        profiles: what might be driven.
        vehicle: the car.
        model: what was learned of it, None for the vehicle file alone.
        air_density: kg/m^3, None for the vehicle's.

    Raises:
        PlanError: shapes do not fit, time does not rise, speed is negative or a number not finite.
    """
    time, speed, _ = profiles
    if speed.ndim != 2 or speed.shape[1] < 2 or time.shape[-1] != speed.shape[1]:
        raise PlanError(
            f"speed {tuple(speed.shape)} and time {tuple(time.shape)} must be (batch, n) and (n,) "
            "or (batch, n), with n of 2 or more"
        )
    model = vehicle_model(vehicle, FIRST_RESIDUAL) if model is None else model
    density = vehicle.air_density if air_density is None else air_density
    if namespace(speed) is not np:
        return _checked(_energies(profiles, model, density))
    rows = range(0, len(speed), CHUNK)
    parts = [
        _energies(Profiles(*(_rows(a, slice(i, i + CHUNK)) for a in profiles)), model, density)
        for i in rows
    ]
    if not parts:
        return Energies(np.empty(0), np.empty(0))
    return _checked(Energies(*map(np.concatenate, zip(*parts, strict=True))))


def forecast_plan(
    plan: Plan, model: PowerModel, air_density: float, head_wind: float = 0.0
) -> Forecast:
    """Energy, power and 1-sigma along a plan.

    Args:
        plan: one trip, or many.
        model: of the car.
        air_density: kg/m^3.
        head_wind: against the car at the start, m/s over ground. Few plans say where they lead,
            so less and less of it is expected along the way; what else the wind may do is in the
            sigma of slopes and winds.

    Raises:
        PlanError: the model gives no finite energy.
    """
    legs = _Legs.of(plan)
    along = plan.distance[..., :-1, None] - plan.distance[..., :1, None]
    wind = head_wind * np.exp(-along / DIRECTION_LENGTH)
    powers = model.powers(Motion(legs.speed, legs.acceleration, legs.climb, air_density, wind))
    steps = np.einsum("...lsk,s,...l->...lk", powers, SIMPSON, legs.duration)
    elapsed = plan.time - plan.time[..., :1]
    energies = model.with_present_drift(_accumulated(steps, axis=-2), elapsed)
    squares = _accumulated((legs.speed**2) @ SIMPSON * legs.duration, axis=-1)
    square_speed = squares / np.where(elapsed > 0, elapsed, 1.0)
    length = plan.distance - plan.distance[..., :1]
    beside = model.variance_beside(elapsed, length, square_speed)
    power = np.concatenate((powers[..., 0, 0], powers[..., -1:, 2, 0]), axis=-1)
    sigma = np.sqrt((energies[..., 1:] ** 2).sum(axis=-1) + beside)
    if not np.isfinite(energies[..., 0] + power + sigma).all():
        raise PlanError("by the model of the car its energy is not finite")
    end = PlanEnd(energies[..., -1, :], elapsed[..., -1], length[..., -1], square_speed[..., -1])
    return Forecast(time=plan.time, energy=energies[..., 0], power=power, sigma=sigma, end=end)


def difference(model: PowerModel, one: PlanEnd, other: PlanEnd) -> Uncertain:
    """Energy that one plan takes more than another, J, with the 1-sigma of that.

    What both share cancels: the car is off by the same coefficients in both, auxiliary power
    drifts alike while both last, and plans of one length lead along the same unknown slopes. The
    residual of the model counts in each.

    Args:
        model: of the car, with which both were forecast.
        one: of a single plan.
        other: likewise, beginning at the same moment and place.
    """
    apart = one.energies - other.energies
    variance = (apart[1:] ** 2).sum() + model.variance_between(one, other)
    return Uncertain(float(apart[0]), math.sqrt(variance))


def battery_after(result: Forecast, charge: Uncertain, capacity: Uncertain) -> Uncertain:
    """State of charge at the end of one plan, 0..1, and its 1-sigma; unknown where either is.

    Args:
        result: forecast of a single plan, shape (n,).
        charge: now, 0..1.
        capacity: usable energy of the full battery, J.

    Returns:
        0 means that the plan ends, or would have ended, with an empty battery.
    """
    left, sigma = battery_along(result, charge, capacity)[:, -1].tolist()
    return Uncertain(min(max(left, 0.0), 1.0), sigma) if math.isfinite(left) else UNKNOWN


def battery_along(result: Forecast, charge: Uncertain, capacity: Uncertain) -> np.ndarray:
    """The same at each point, shape (2, n): NaN where unknown, and below 0 it is empty."""
    share = result.energy / capacity.value
    parts = charge.sigma, result.sigma / capacity.value, share * capacity.sigma / capacity.value
    return np.stack([charge.value - share, np.sqrt(sum(part**2 for part in parts))])


def _energies(profiles: Profiles, model: PowerModel, density: float) -> Energies:
    time, speed, elevation = profiles
    xp = namespace(speed)
    duration = xp.diff(time)
    if not bool((duration > 0).all()):
        raise PlanError("time does not rise")
    if not bool((xp.isfinite(speed) & (speed >= 0)).all()):
        raise PlanError("speed is negative or not finite")
    duration = xp.broadcast_to(duration, (speed.shape[0], speed.shape[1] - 1))
    middle = 0.5 * (speed[:, 1:] + speed[:, :-1])
    climb = xp.zeros_like(middle) if elevation is None else xp.diff(elevation) / duration
    motion = Motion(middle, xp.diff(speed) / duration, climb, density)
    energies = model.energies(motion, duration)
    elapsed = duration.sum(-1)
    energies = model.with_present_drift(energies, elapsed)
    length = middle * duration
    square = (middle * length).sum(-1) / elapsed
    variance = (energies[:, 1:] ** 2).sum(-1) + model.variance_beside(
        elapsed, length.sum(-1), square
    )
    return Energies(energies[:, 0], xp.sqrt(variance))


def _rows(array: Any, rows: slice) -> Any:
    return array if array is None or array.ndim == 1 else array[rows]


def _checked(found: Energies) -> Energies:
    if not bool(namespace(found.sigma).isfinite(found.energy + found.sigma).all()):
        raise PlanError("a number of the profiles is not finite")
    return found


def _accumulated(steps: np.ndarray, axis: int) -> np.ndarray:
    """Sum up to each point along an axis, which becomes one longer."""
    start = np.zeros_like(steps.take([0], axis=axis))
    return np.concatenate((start, np.cumsum(steps, axis=axis)), axis=axis)


@dataclass(frozen=True, slots=True)
class _Legs:
    """Start, middle and end of every leg: shape (..., n - 1, 3); duration (..., n - 1), s.

    Distance is cubic in time, so speed is the parabola with the given ends and the leg's length
    as its integral. Power then is smooth but for the kink, and Simpson's rule gives kinetic and
    potential energy exactly.
    """

    duration: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    climb: np.ndarray

    @classmethod
    def of(cls, plan: Plan) -> _Legs:
        dt, length = np.diff(plan.time), np.diff(plan.distance)
        start, end = plan.speed[..., :-1], plan.speed[..., 1:]
        # A profile whose speeds contradict its distances could call for reversing in the middle.
        middle = np.maximum(1.5 * length / dt - (start + end) / 4, 0.0)
        bend = 4 * middle
        slope = [-3 * start + bend - end, end - start, start - bend + 3 * end]
        speed = np.stack([start, middle, end], axis=-1)
        moving = np.where(length > 0, length, np.inf)
        grade = np.clip(np.diff(plan.elevation) / moving, -1.0, 1.0)  # its sine
        return cls(
            duration=dt,
            speed=speed,
            acceleration=np.stack(slope, axis=-1) / dt[..., None],
            climb=speed * grade[..., None],
        )
