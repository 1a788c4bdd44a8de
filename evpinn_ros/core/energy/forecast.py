"""The energy that plans will take, and how sure that is.

`forecast` is for optimisers: many speed profiles at once, whole trips, numpy or torch.
`forecast_plan` is for one plan, or a few, with energy and power at every point. Both take each leg
as one step of the one equation (`energy.power_model`): kinetic and potential energy are exact
whatever the leg. The variance of the energy of a trip adds up what is not known of the car and of
this drive, off in the same sense for the whole trip; loads that wander; what no state explains;
and the hills of a plan that has none.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.arrays import namespace
from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, Units
from evpinn_ros.core.energy.charge import ChargeGauge, Uncertain
from evpinn_ros.core.energy.plan import COARSE, Legs, Plan, PlanConditions, PlanError, points_of
from evpinn_ros.core.energy.power_model import PlanEnd, PowerModel, Weather, vehicle_model
from evpinn_ros.core.estimation.gaussian import Gaussian, at_least_zero, condition, innovate
from evpinn_ros.core.estimation.journey import standing, wandered
from evpinn_ros.core.estimation.states import SIZE, State
from evpinn_ros.core.estimation.terms import COUNT, LOSSES, WHOLE, Part
from evpinn_ros.core.estimation.unevenness import (
    Path,
    even_path,
    legs_of_speed,
    size_of,
    stops_of,
)
from evpinn_ros.core.signals.interval import Steps
from evpinn_ros.core.signals.road import density_of_air
from evpinn_ros.core.vehicle.files import Vehicle

SMALL_CHANGE = 0.5  # m/s from point to point of a speed that is commanded
MOST_STRAIGHT = 100_000  # points between those of a plan
# m within which a trip turns away from where the car now points, and from the wind measured there
DIRECTION_LENGTH = 5e3
UNKNOWN_END = PlanEnd(np.full(SIZE, math.nan), *(math.nan,) * 5)
# Profiles computed together, and about their points, so that what they need stays in the cache.
TOGETHER, POINTS_TOGETHER = 64, 24_000


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


class Air(NamedTuple):
    """The air outside; None where nothing fresh tells.

    Attributes:
        celsius: temperature.
        pascal: pressure.
        head: wind against the car as it points now, m/s over ground.
    """

    celsius: float | None = None
    pascal: float | None = None
    head: float | None = None


UNKNOWN_AIR = Air()
UNEVEN = "speeding up and braking between the points"
SHORT_OF_HEIGHTS = 0.01  # of the way without heights, from here on worth saying


class PlanBasis(NamedTuple):
    """Arguments of `forecast_plan` beside the plan."""

    model: PowerModel
    weather: Weather
    head_wind: float
    wind_length: float
    steady: bool | None

    @classmethod
    def of(
        cls,
        model: PowerModel,
        given: PlanConditions,
        air: Air = UNKNOWN_AIR,
        density: float | None = None,
    ) -> PlanBasis:
        """The basis of a trip's forecast.

        Args:
            model: of the car.
            given: what a planner expects.
            air: measured, for what is not given.
            density: of the air, kg/m^3; None: by its temperature and pressure.
        """
        celsius = air.celsius if given.temperature is None else given.temperature
        head_wind, wind_length = given.head_wind, math.inf
        if head_wind is None:
            head_wind, wind_length = air.head, DIRECTION_LENGTH
        if density is None:
            reference = model.car.equation.vehicle.air_density
            outside = (math.nan if value is None else value for value in (celsius, air.pascal))
            density = float(density_of_air(reference, *outside))
        start = model.start(given.stood, given.prewarmed or 0.0)
        weather = Weather(density, celsius, given.heating, start)
        loaded = model.with_payload(given.payload or 0.0)
        steady = None if given.steady is None else given.steady >= 0.5
        return cls(loaded, weather, head_wind or 0.0, wind_length, steady)


class PlannedEnergy(NamedTuple):
    """Energy of a plan.

    Attributes:
        given: the plan as it was given.
        trip: its points.
        basis: the car and the conditions of the forecast.
        energies: along it.
        charge: state of charge at each point, 0..1, and its 1-sigma, shape (2, n); NaN where
            unknown, below 0 where the battery is empty before.
        gauge: what is known of the battery.
    """

    given: Plan | Legs
    trip: Plan
    basis: PlanBasis
    energies: Forecast
    charge: np.ndarray
    gauge: ChargeGauge

    @property
    def uneven(self) -> float:
        """The part of its energy that uneven speed between its points takes, J."""
        energies, _ = plan_parts(self.given, self.energies, *self.basis)
        return float(energies[-1])

    @property
    def uneven_part(self) -> str | None:
        """Sentence on that part; None where it would read 0.00."""
        part, whole = self.uneven / JOULES_PER_KWH, self.energies.energy[-1] / JOULES_PER_KWH
        if part < 0.005:
            return None
        return f"{part:.2f} of the {whole:.2f} kWh is for {UNEVEN}; --steady leaves it out."

    def no_heights(self, units: Units = METRIC) -> str | None:
        """Sentence on the part of the way whose height is not known; None where all is."""
        unseen, whole = self.energies.end.unseen, float(np.ptp(self.trip.distance))
        if not unseen > SHORT_OF_HEIGHTS * whole:
            return None
        metres = units.metres
        part = f" for {unseen / metres:.1f} of {whole / metres:.1f} {units.distance}"
        part = "" if unseen > (1.0 - SHORT_OF_HEIGHTS) * whole else part
        return (
            f"no heights{part}: a level road is assumed; the 1-sigma allows for hills like those "
            "of earlier drives"
        )

    @property
    def better_expert(self) -> str | None:
        """Sentence on what it rests on in place of the learned car; None where on that."""
        return self.basis.model.car.experts.sentence

    @property
    def empty_at(self) -> float | None:
        """Distance at which the battery is empty, m; None if it lasts, or nothing is known."""
        along, charge = self.trip.distance - self.trip.distance[0], self.charge[0]
        if not (charge <= 0.0).any():
            return None
        end = int((charge <= 0.0).argmax())
        here = slice(max(end - 1, 0), end + 1)
        return float(np.interp(0.0, charge[here][::-1], along[here][::-1]))


class Change(NamedTuple):
    """A trip driven otherwise: what, the energy it takes more, J, and the time, s."""

    words: str
    energy: Uncertain
    seconds: float


def forecast(
    profiles: Profiles,
    vehicle: Vehicle,
    model: PowerModel | None = None,
    *,
    air_density: float | None = None,
) -> Energies:
    """Energy of many speed profiles, and its 1-sigma.

    With torch the results have gradients by all three. Power bends where the car turns from
    driving to braking, and where the table of the network goes on to its next node; the gradient
    is that of the pieces.

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
    model = vehicle_model(vehicle) if model is None else model
    density = vehicle.air_density if air_density is None else air_density
    batch = max(1, min(TOGETHER, POINTS_TOGETHER // speed.shape[1]))
    parts = []
    for begin in range(0, len(speed), batch):
        some = (
            profile if profile is None or profile.ndim == 1 else profile[begin : begin + batch]
            for profile in profiles
        )
        parts.append(_sums(Profiles(*some), model, density))
    if not parts:
        return Energies(speed[:, 0], speed[:, 0])
    xp = namespace(speed)
    rows, elapsed, stood, square, unseen = map(xp.concatenate, zip(*parts, strict=True))
    noise = model.noise(elapsed, stood, square)
    energies = Energies(*model.predicted(rows, elapsed, noise, unseen))
    if not bool(xp.isfinite(energies.energy + energies.sigma).all()):
        raise PlanError("a number of the profiles is not finite")
    return energies


def forecast_plan(
    plan: Plan | Legs,
    model: PowerModel,
    weather: Weather,
    head_wind: float = 0.0,
    wind_length: float = math.inf,
    steady: bool | None = None,
    *,
    along: bool = True,
) -> Forecast:
    """Energy, power and 1-sigma along a plan.

    Where its points lie further apart than some seconds, what drivers do between them is expected,
    as this car's drives had it (`estimation.unevenness`), unless its speeds are commanded.

    Args:
        plan: one trip, legs of one, or many trips.
        model: of the car.
        weather: on the way.
        head_wind: against the car at the start, m/s over ground.
        wind_length: m within which it fades to a third. Few plans say where they lead, so less and
            less of a wind that was measured is expected along the way; one that is stated stays.
        steady: True if speeds are commanded, False if expected; None: as the plan has it. Of legs
            the mean speeds are then driven evenly.
        along: whether sigma is wanted at every point of one trip; without it may be NaN at all
            but the last, which takes half the time.

    Raises:
        PlanError: the model gives no finite energy.
    """
    points = points_of(plan)
    steady, coarse = is_steady(plan, steady), _is_coarse(plan)
    given_points: Any = slice(None)
    if coarse and steady and isinstance(plan, Plan):
        (plan, given_points), coarse = _straight(plan), False
        points = plan
    wind = _wind(points, head_wind, wind_length)
    elapsed = points.time - points.time[..., :1]
    duration, length = np.diff(points.time), np.diff(points.distance)
    if isinstance(plan, Legs):
        unknown = plan.length * ~plan.height_known
    else:
        unknown = length * (np.ptp(plan.elevation, axis=-1, keepdims=True) == 0.0)
    uneven = np.zeros_like(length)
    steps = standing(duration, length), length**2 / duration, unknown
    stood, square, unseen = (np.cumsum(sums_of_step, axis=-1) for sums_of_step in steps)
    noise = model.noise(elapsed[..., 1:], stood, square)
    energies = None
    if coarse:
        path = _path(points, weather.air_density, wind)
        legs, beyond = model.leg_rows(path, weather, even=steady)
        uneven = size_of(np.abs(beyond @ model.car.mean), stops_of(path, model.car.mean))
        rows = np.cumsum(legs, axis=0)
    elif along or duration.ndim > 1:
        rows = model.rows_along(_steps(points, wind), weather)
    else:
        row, energies = model.whole_row(_steps(points, wind), weather)
        rows = row[None]
    sums = elapsed[..., 1:], noise, unseen, uneven
    energy, sigma = model.predicted(
        rows, *(sums_of_row[..., -rows.shape[-2] :] for sums_of_row in sums)
    )
    possible = np.isfinite(sigma).all()
    if energies is not None:
        energy = np.cumsum(energies) + model.car.mean[State.LOAD] * wandered(elapsed[1:])[1]
        sigma = np.concatenate((np.full(len(energy) - 1, math.nan), sigma))
    zero = np.zeros_like(elapsed[..., :1])
    energy, sigma = (
        np.concatenate((zero, series), -1)[..., given_points] for series in (energy, sigma)
    )
    time = points.time[..., given_points]
    power = np.diff(energy) / np.diff(time)
    power = np.concatenate((power, power[..., -1:]), axis=-1)
    if not (possible and np.isfinite(energy + power).all()):
        raise PlanError("by the model of the car its energy is not finite")
    end = UNKNOWN_END
    if energy.ndim == 1:
        whole = elapsed, points.distance - points.distance[0], noise, unseen, uneven
        end = PlanEnd(rows[-1], *(float(last[-1]) for last in whole))
    return Forecast(time=time, energy=energy, power=power, sigma=sigma, end=end)


def plan_parts(
    plan: Plan | Legs,
    forecast: Forecast,
    model: PowerModel,
    weather: Weather,
    head_wind: float = 0.0,
    wind_length: float = math.inf,
    steady: bool | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Energies of one trip by part and their 1-sigma, J, shape (COUNT + 1,) each.

    They are in the order of `terms.Part`; the last is what uneven speed between the points takes.

    Args:
        plan: the trip.
        forecast: its forecast, with the arguments that follow.
        model: of the car.
        weather: on the way.
        head_wind: against the car at the start, m/s over ground.
        wind_length: m within which it fades to a third.
        steady: True if its speeds are commanded.
    """
    points = points_of(plan)
    if _is_coarse(plan) and isinstance(plan, Plan):
        points, _ = _straight(plan)
    wind = _wind(points, head_wind, wind_length)
    steps = _steps(points, wind)
    if isinstance(plan, Legs):
        steps = Steps(*even_path(_path(points, weather.air_density, wind))[:5])
    rows = np.concatenate((model.parts(steps, weather), np.zeros((1, SIZE))))
    rows[Part.STANDING, State.LOAD] = forecast.end.row[State.LOAD]
    rows[-1] = forecast.end.row - rows[WHOLE].sum(0)
    car = model.car
    covariance = car.trust * (rows @ model.covariance @ rows.T)
    covariance[-1, -1] += (car.unevenness.share * forecast.end.uneven) ** 2
    # No part of what is known as a whole, and none beside it, is a negative loss.
    whole, exactly = np.zeros(COUNT), np.zeros(())
    whole[WHOLE] = 1.0
    energies = rows @ car.mean
    parts = Gaussian(energies[:-1], covariance[:-1, :-1])
    parts = condition(parts, innovate(parts, whole, exactly, exactly), exactly)
    energies[:-1] = at_least_zero(parts, LOSSES)
    return energies, np.sqrt(np.maximum(np.diag(covariance), 0.0))


def is_steady(plan: Plan | Legs, steady: bool | None) -> bool:
    """True if the speeds of a plan are commanded: as asked, else as it says."""
    return isinstance(plan, Plan) and plan.commanded if steady is None else steady


def _is_coarse(plan: Plan | Legs) -> bool:
    """True for one trip whose speed varies between its points: for legs know their means alone."""
    if isinstance(plan, Legs):
        return True
    duration = np.diff(plan.time)
    return duration.ndim == 1 and float(np.median(duration)) > COARSE


def _straight(plan: Plan) -> tuple[Plan, np.ndarray]:
    """One trip with points between its own, as `_steps` has speeds there, and which its own are.

    So many that speed changes little from each to the next.
    """
    duration, length = np.diff(plan.time), np.diff(plan.distance)
    start, end = plan.speed[:-1], plan.speed[1:]
    middle = np.maximum(1.5 * length / duration - (start + end) / 4.0, 0.0)
    change = np.abs(middle - start) + np.abs(end - middle)
    most = max(MOST_STRAIGHT // len(length), 1)
    pieces = np.clip(np.ceil(change / SMALL_CHANGE), 1, most).astype(int)
    given_points = np.concatenate(([0], np.cumsum(pieces)))
    leg = np.repeat(np.arange(len(length)), pieces)
    share = (np.arange(given_points[-1]) - given_points[leg]) / pieces[leg]
    first, last, top = start[leg], end[leg], middle[leg]
    rise, bend = 4.0 * top - 3.0 * first - last, 2.0 * (first + last) - 4.0 * top
    speed = np.maximum(first + share * (rise + share * bend), 0.0)
    way = share * (first + share * (rise / 2.0 + share * bend / 3.0))
    whole = (start + 4.0 * middle + end) / 6.0
    way = np.divide(way, whole[leg], out=share.copy(), where=whole[leg] > 0.0)

    def between(column: np.ndarray, along: np.ndarray) -> np.ndarray:
        return np.append(column[leg] + along * np.diff(column)[leg], column[-1])

    way = np.maximum.accumulate(np.clip(way, 0.0, 1.0) + leg) - leg
    time, distance = between(plan.time, share), between(plan.distance, way)
    fine = Plan(time, distance, np.append(speed, plan.speed[-1]), between(plan.elevation, way),
                commanded=True)  # fmt: skip
    return fine, given_points


def _wind(points: Plan, head_wind: float, length: float) -> np.ndarray:
    """Wind against the car at each point, m/s."""
    along = points.distance - points.distance[..., :1]
    return np.asarray(head_wind * np.exp(-along / length))


def _path(points: Plan, density: float, wind: np.ndarray) -> Path:
    """Legs between points of one trip, shape (n - 1,); wind: against the car at each, m/s."""
    columns = (np.diff(column) for column in (points.time, points.distance, points.elevation))
    return legs_of_speed(*columns, density=density, wind=(wind[1:] + wind[:-1]) / 2.0)


def _steps(plan: Plan, wind: np.ndarray) -> Steps:
    """Steps between the points of one trip, or many; wind: against the car at each, m/s.

    Distance is cubic in time between two points, so speed is the parabola with the given ends and
    the leg's length as its integral.
    """
    duration, length = np.diff(plan.time), np.diff(plan.distance)
    start, end = plan.speed[..., :-1], plan.speed[..., 1:]
    # A profile whose speeds contradict its distances could call for reversing in the middle.
    middle = np.maximum(1.5 * length / duration - (start + end) / 4, 0.0)
    first, last = wind[..., :-1], wind[..., 1:]

    def drag(speed: np.ndarray, wind: np.ndarray) -> np.ndarray:
        flow = speed + wind
        return np.asarray(flow * np.abs(flow) * speed)

    air = drag(start, first) + 4.0 * drag(middle, (first + last) / 2.0) + drag(end, last)
    kinetic = (end**2 - start**2) / 2.0
    return Steps(duration, length, air * duration / 6.0, kinetic, np.diff(plan.elevation))


def _sums(profiles: Profiles, model: PowerModel, density: float) -> tuple[Any, ...]:
    """Sums over each profile: its row; s; s standing; integral of speed squared; m not seen."""
    time, speed, elevation = profiles
    xp = namespace(speed)
    duration = xp.diff(time)
    if not bool((duration > 0).all()):
        raise PlanError("time does not rise")
    if not (speed.min() >= 0 and speed.max() < math.inf):  # neither is NaN
        raise PlanError("speed is negative or not finite")
    duration = duration.reshape(-1, duration.shape[-1])  # of all trips, or one each
    twice, half = speed[:, :-1] + speed[:, 1:], 0.5 * speed**2
    length = twice * (0.5 * duration)
    climb: Any = 0.0 if elevation is None else xp.diff(elevation)
    if elevation is not None and not bool(xp.isfinite(climb.sum())):
        raise PlanError("elevation is not finite")
    # The integral of v^3 where speed is linear; (a + b)(a^2 + b^2) / 4 is exact.
    air = length * (half[:, :-1] + half[:, 1:])
    rows = model.summed_rows(Steps(duration, length, air, xp.diff(half), climb), Weather(density))
    stood, square = standing(duration, length).sum(-1), 0.5 * (twice * length).sum(-1)
    unseen = length.sum(-1) * (elevation is None)
    return rows, xp.broadcast_to(duration.sum(-1), stood.shape), stood, square, unseen
