"""Forecasts the energy of plans, with its 1-sigma.

`forecast` is for optimisers: many speed profiles at once, whole trips, numpy or torch.
`forecast_plan` is for one plan, or a few, with energy and power at every point. Both take each leg
as one step of the one equation (`energy.power_model`), so kinetic and potential energy are exact
for legs of any length. The variance of a trip's energy is a sum: errors about the car and the
drive, of the same sense all along; wandering loads; energy that no state explains; unseen hills.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.arrays import namespace
from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, Units
from evpinn_ros.core.energy.charge import ChargeGauge, Uncertain
from evpinn_ros.core.energy.course import Course, course_of
from evpinn_ros.core.energy.plan import COLUMNS, Legs, Plan, PlanConditions, PlanError, points_of
from evpinn_ros.core.energy.power_model import PlanEnd, PowerModel, Weather, vehicle_model
from evpinn_ros.core.estimation.gaussian import Gaussian, at_least_zero, condition, innovate
from evpinn_ros.core.estimation.journey import standing, wandered
from evpinn_ros.core.estimation.states import LASTING, SIZE, State
from evpinn_ros.core.estimation.terms import COUNT, LOSSES, WHOLE, Part
from evpinn_ros.core.estimation.unevenness import UNEVEN_STATES, size_of, sizes_of
from evpinn_ros.core.signals.interval import Steps
from evpinn_ros.core.vehicle.files import Vehicle

# m in which a trip turns away from the present heading, and so from the measured head wind
DIRECTION_LENGTH = 5e3
UNKNOWN_END = PlanEnd(np.full(SIZE, math.nan), *(math.nan,) * 5)
# Profiles, and about as many of their points, that are computed together and fit into the cache.
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
    """Energy of each profile and its 1-sigma, J, shape (batch,), as arrays of the input's kind."""

    energy: Any
    sigma: Any


class EnergyCurve(NamedTuple):
    """Energy at the n points of a `Course`, which differ from the plan's: arrays of shape (n,).

    Attributes:
        time: s since the start.
        distance: m since the start.
        energy: J since the start.
        sigma: 1-sigma of energy, J; without `along` it is NaN except at the end.
    """

    time: np.ndarray
    distance: np.ndarray
    energy: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Energy along a plan; all arrays have the plan's shape, (n,) or (batch, n).

    Attributes:
        time: s.
        energy: J since the first point; it falls where the car regenerates.
        power: mean of the leg that follows each point, W; at the last point, of the last leg.
        sigma: 1-sigma of energy, J.
        end: of the whole plan, for comparisons with others.
        curve: energy along a single plan, None for a batch.
    """

    time: np.ndarray
    energy: np.ndarray
    power: np.ndarray
    sigma: np.ndarray
    end: PlanEnd = UNKNOWN_END
    curve: EnergyCurve | None = None

    @property
    def on_curve(self) -> Forecast:
        """The forecast at the points of its curve in place of the plan's."""
        if self.curve is None:
            return self
        time, _, energy, sigma = self.curve
        power = np.diff(energy) / np.diff(time)
        power = np.append(power, power[-1])
        return Forecast(self.time[0] + time, energy, power, sigma, self.end, self.curve)


class Air(NamedTuple):
    """The air outside; None where no recent value is known.

    Attributes:
        celsius: temperature, degrees Celsius.
        pascal: pressure, Pa.
        head: wind against the car at its present heading, m/s over ground.
    """

    celsius: float | None = None
    pascal: float | None = None
    head: float | None = None


UNKNOWN_AIR = Air()
UNEVEN = "speeding up and braking that the plan does not show"
# Share of the vehicle file's 1-sigma that is left for a plan, from which on a note says so.
HARDLY_DRIVEN = 0.7
EMPTY = 1e-6  # state of charge; less is rounding
SHORT_OF_HEIGHTS = 0.01  # share of the distance without heights, above which a note says so


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
            given: conditions that a planner expects.
            air: measured, for conditions that are not given.
            density: of the air, kg/m^3; None: by its temperature and pressure.
        """
        celsius = air.celsius if given.temperature is None else given.temperature
        head_wind, wind_length = given.head_wind, math.inf
        if head_wind is None:
            head_wind, wind_length = air.head, DIRECTION_LENGTH
        if density is None:
            density = model.density(celsius, air.pascal)
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
        energies: forecast of the plan.
        course: state of charge along its curve, 0..1, and 1-sigma, shape (2, m); NaN where
            unknown, 0 or less where the battery is empty.
        full: energy that the full battery gives at the mean power of the plan, J.
        gauge: state of charge and capacity.
    """

    given: Plan | Legs
    trip: Plan
    basis: PlanBasis
    energies: Forecast
    course: np.ndarray
    full: Uncertain
    gauge: ChargeGauge

    @property
    def rows(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Times of the points, s, and columns of values there, named with their units."""
        trip, energies, charge = self.trip, self.energies, 100.0 * self.charge
        return energies.time, {
            "distance_m": trip.distance,
            "speed_mps": trip.speed,
            "elevation_m": trip.elevation,
            "power_w": energies.power,
            "energy_j": energies.energy,
            "sigma_j": energies.sigma,
            "charge_pct": charge[0],
            "charge_sigma_pct": charge[1],
        }

    @property
    def charge(self) -> np.ndarray:
        """`course` at each of the n points of the trip, shape (2, n)."""
        times, curve = self.energies.time, self.energies.on_curve
        return np.stack([np.interp(times, curve.time, column) for column in self.course])

    @property
    def uneven(self) -> float:
        """Energy that uneven speed between the points takes, J."""
        energies, _ = plan_parts(self.given, self.energies, *self.basis)
        return float(energies[-1])

    @property
    def uneven_part(self) -> str | None:
        """Sentence on `uneven`; None if it rounds to 0.00 kWh."""
        part, whole = self.uneven / JOULES_PER_KWH, self.energies.energy[-1] / JOULES_PER_KWH
        if part < 0.005:
            return None
        return f"{part:.2f} of the {whole:.2f} kWh is for {UNEVEN}"

    def no_heights(self, units: Units = METRIC) -> str | None:
        """Sentence on the distance without heights; None if all are known."""
        unseen, whole = self.energies.end.unseen, float(np.ptp(self.trip.distance))
        if not unseen > SHORT_OF_HEIGHTS * whole:
            return None
        metres = units.metres
        part = f" for {unseen / metres:.1f} of {whole / metres:.1f} {units.distance}"
        part = "" if unseen > (1.0 - SHORT_OF_HEIGHTS) * whole else part
        return (
            f"no heights{part}: a level road is assumed; the uncertainty allows for hills like "
            "those of earlier drives"
        )

    @property
    def beyond_driven(self) -> str | None:
        """Sentence if earlier drives taught little about such a plan, else None."""
        row, car = self.energies.end.row[LASTING], self.basis.model.car
        lasting = np.ix_(LASTING, LASTING)
        learned, file = (
            float(row @ covariance[lasting] @ row)
            for covariance in (car.covariance, car.equation.covariance)
        )
        if not car.record.drives or learned < HARDLY_DRIVEN**2 * file:
            return None
        return "this car has hardly driven so; the uncertainty is mostly that of its vehicle file"

    @property
    def record(self) -> str | None:
        """Sentence on how well this car's drives were predicted; None before any."""
        return self.basis.model.car.record.sentence

    @property
    def empty_at(self) -> float | None:
        """Distance at which the battery is empty, m; None if it lasts or is unknown."""
        return self.used_up(0.0)

    def used_up(self, sigmas: float) -> float | None:
        """Distance at which the charge plus `sigmas` of its 1-sigma is used up, m, or None."""
        curve, charge = self.energies.curve, self.course[0] + sigmas * self.course[1]
        if curve is None or not (charge <= EMPTY).any():
            return None
        end = int((charge <= EMPTY).argmax())
        here = slice(max(end - 1, 0), end + 1)
        return float(np.interp(0.0, charge[here][::-1], curve.distance[here][::-1]))


class Change(NamedTuple):
    """A variation of a trip: its name, additional energy, J, and additional time, s."""

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

    With torch, the results have gradients by time, speed and elevation. Power has kinks between
    driving and braking, and at the nodes of the network's table: gradients are one-sided there.

    Args:
        profiles: candidates.
        vehicle: the car.
        model: the learned car, None for the vehicle file alone.
        air_density: kg/m^3, None for that at the last temperature of the model.

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
    density = model.density() if air_density is None else air_density
    batch = max(1, min(TOGETHER, POINTS_TOGETHER // speed.shape[1]))
    parts = []
    for begin in range(0, len(speed), batch):
        columns = (
            column if column is None or column.ndim == 1 else column[begin : begin + batch]
            for column in profiles
        )
        parts.append(_sums(Profiles(*columns), model, density))
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

    It is computed on the plan's course (`energy.course`), so redundant points and borders change
    nothing. On lines and legs longer than some seconds, uneven speed is expected as in this car's
    drives (`estimation.unevenness`), unless speeds are commanded.

    Args:
        plan: one trip, legs of one, or many trips.
        model: of the car.
        weather: on the way.
        head_wind: against the car at the start, m/s over ground.
        wind_length: m within which the wind fades to 1/e. Most plans have no direction, so a
            measured wind fades along the way; a given one stays.
        steady: True if speeds are commanded (legs: driven evenly), False if expected; None: as
            the plan has it.
        along: whether to compute sigma at every point of one trip; without it sigma may be NaN
            except at the last point, which takes half the time.

    Raises:
        PlanError: the model gives no finite energy.
    """
    points = points_of(plan)
    if points.time.ndim > 1:
        return _forecast_batch(points, model, weather, head_wind, wind_length, steady)
    course = course_of(plan, weather.air_density, head_wind, wind_length)
    steps, elapsed = course.steps, course.time[1:]
    still = standing(steps.duration, steps.distance), steps.distance**2 / steps.duration
    stood, square, unseen = (np.cumsum(column) for column in (*still, course.unknown))
    noise = model.noise(elapsed, stood, square)
    beyond, uneven = _beyond(course, model, steady=is_steady(plan, steady))
    sums_along = elapsed, noise, unseen, uneven
    if along:
        rows = model.rows_along(steps, weather)
        rows[:, UNEVEN_STATES] += np.cumsum(beyond, axis=0)
        energy, sigma = model.predicted(rows, *sums_along)
        row, possible = rows[-1], np.isfinite(sigma).all()
    else:
        row, energies = model.whole_row(steps, weather)
        row[UNEVEN_STATES] += beyond.sum(0)
        _, last = model.predicted(row[None], *(column[-1:] for column in sums_along))
        energy = np.cumsum(energies + beyond @ model.car.mean[UNEVEN_STATES])
        energy += model.car.mean[State.LOAD] * wandered(elapsed)[1]
        sigma = np.append(np.full(len(energy) - 1, math.nan), last)
        possible = np.isfinite(last).all()
    energy, sigma = (np.concatenate(([0.0], column)) for column in (energy, sigma))
    curve = EnergyCurve(course.time, course.distance, energy, sigma)
    time = np.append((points.time - points.time[0])[:-1], curve.time[-1])  # equal but for rounding
    energy = np.interp(time, curve.time, curve.energy)
    sigma = np.interp(time, curve.time, curve.sigma)
    power = np.diff(energy) / np.diff(time)
    power = np.append(power, power[-1])
    if not (possible and np.isfinite(energy + power).all()):
        raise PlanError("by the model of the car its energy is not finite")
    whole = elapsed, course.distance[1:], noise, unseen, uneven
    end = PlanEnd(row, *(float(column[-1]) for column in whole))
    return Forecast(points.time, energy, power, sigma, end, curve)


def _forecast_batch(points: Plan, *basis: Any) -> Forecast:
    """`forecast_plan` for each trip of a batch."""
    columns = zip(*(getattr(points, name) for name in COLUMNS), strict=True)
    plans = [replace(points, **dict(zip(COLUMNS, trip, strict=True))) for trip in columns]
    trips = [forecast_plan(plan, *basis) for plan in plans]
    time, energy, power, sigma = (
        np.stack([getattr(trip, name) for trip in trips])
        for name in ("time", "energy", "power", "sigma")
    )
    return Forecast(time, energy, power, sigma)


def _beyond(course: Course, model: PowerModel, *, steady: bool) -> tuple[np.ndarray, np.ndarray]:
    """Energy of each step beyond even speed, by state, and its size up to there.

    Returns:
        J per unit of `UNEVEN_STATES`, shape (n, 3); and `unevenness.size_of`, J, shape (n,).
    """
    car, runs = model.car, course.runs
    if steady:
        return np.zeros((len(course.run), len(UNEVEN_STATES))), np.zeros(len(course.run))
    rows = car.unevenness.rows(car.equation, runs)
    sizes = sizes_of(runs, rows @ car.mean[UNEVEN_STATES], car.mean)
    length = runs.distance[course.run]
    share = np.divide(course.steps.distance, length, out=np.zeros_like(length), where=length > 0)
    so_far = (np.cumsum(share * size[course.run]) for size in sizes)
    return rows[course.run] * share[:, None], size_of(*so_far)


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

    In the order of `terms.Part`; the last is the energy of uneven speed between the points.

    Args:
        plan: the trip.
        forecast: of the trip, by `forecast_plan` with the same arguments.
        model: of the car.
        weather: on the way.
        head_wind: against the car at the start, m/s over ground.
        wind_length: m within which the wind fades to 1/e.
        steady: True if its speeds are commanded.
    """
    course = course_of(plan, weather.air_density, head_wind, wind_length)
    rows = np.concatenate((model.parts(course.steps, weather), np.zeros((1, SIZE))))
    rows[Part.STANDING, State.LOAD] = forecast.end.row[State.LOAD]
    rows[-1] = forecast.end.row - rows[WHOLE].sum(0)
    car = model.car
    covariance = car.trust * (rows @ model.covariance @ rows.T)
    covariance[-1, -1] += (car.unevenness.share * forecast.end.uneven) ** 2
    # No loss is negative, and the whole is kept.
    whole, exactly = np.zeros(COUNT), np.zeros(())
    whole[WHOLE] = 1.0
    energies = rows @ car.mean
    parts = Gaussian(energies[:-1], covariance[:-1, :-1])
    parts = condition(parts, innovate(parts, whole, exactly, exactly), exactly)
    energies[:-1] = at_least_zero(parts, LOSSES)
    return energies, np.sqrt(np.maximum(np.diag(covariance), 0.0))


def is_steady(plan: Plan | Legs, steady: bool | None) -> bool:
    """True if the speeds of a plan are commanded: `steady`, or the plan's flag if that is None."""
    return plan.commanded if steady is None else steady


def _sums(profiles: Profiles, model: PowerModel, density: float) -> tuple[Any, ...]:
    """Sums over each profile: row, s, s standing, integral of v^2, m^2/s, m without heights."""
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
