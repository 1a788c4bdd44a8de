"""Compares breakdowns of energy with the true energies of simulated cars.

Readings go through the stream and the learning of the car (`benchmarks.truth.CarChain`). Each part
of the breakdown, with its 1-sigma, is compared with the true energy of this part over the learned
intervals.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.truth import INTERVAL, PROFILE, CarChain, simulated_drives
from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.core.estimation.breakdown import DIFFERENCE_METRES, Breakdown
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.terms import WHOLE, Equation, Part
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.core.vehicle.physics import GRAVITY
from evpinn_ros.replays.simulation.car import STEP, Car, Trace
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import EPOCH_NS, simulate
from evpinn_ros.replays.simulation.truth import prior_parameters

CLIMB = Part.SLOPE, Part.BRAKES, Part.DRIVETRAIN  # parts that a climb without heights changes


@dataclass(frozen=True, slots=True)
class PartCheck:
    """One part of the breakdown of a drive, or several joined, and its truth."""

    vehicle: str
    kind: str
    seed: int
    name: str
    kwh: float
    sigma_kwh: float
    true_kwh: float
    total_kwh: float

    @property
    def covered(self) -> bool:
        """True if the interval of 95 % holds the truth."""
        return self.within(INTERVAL)

    def within(self, sigmas: float) -> bool:
        """Whether the truth lies within `sigmas`."""
        return abs(self.kwh - self.true_kwh) <= sigmas * self.sigma_kwh


class SpanChain(CarChain):
    """A chain that records begin and end of the learned intervals, s since `EPOCH_NS`."""

    def __init__(self, vehicle: Vehicle, car: LearnedCar | None = None) -> None:
        """Start from the priors of a vehicle file, or from a car that began another drive."""
        super().__init__(vehicle)
        self.car = car or self.car
        self.spans: list[tuple[float, float]] = []

    def take(self, interval: Interval) -> None:
        """Learn from an interval."""
        before = self.seconds
        super().take(interval)
        if self.seconds > before:
            begin, end = interval.start_ns - EPOCH_NS, interval.end_ns - EPOCH_NS
            self.spans.append((begin / NANOSECONDS, end / NANOSECONDS))

    @property
    def seconds(self) -> float:
        """Length of all intervals in the breakdown."""
        return self.car.parts.totals.seconds

    @property
    def breakdown(self) -> Breakdown | None:
        """Present breakdown."""
        return self.car.breakdowns().of(-1)


def part_checks(
    kinds: Sequence[DriveKind],
    vehicles: Sequence[str],
    seeds: Iterable[int],
    *,
    seconds: float = 900.0,
    **options: Any,
) -> Iterator[PartCheck]:
    """Drive one car per seed and compare each part of its breakdown with the truth.

    `options` are those of `simulated_drives`.
    """
    for drive in simulated_drives(kinds, vehicles, seeds, seconds, **options):
        chain = SpanChain(drive.vehicle)
        chain.add_readings(drive.readings)
        breakdown = chain.breakdown
        if breakdown is None:
            continue
        truth = true_parts(drive.car, drive.trace, chain.spans)
        # No load of a simulated car is heating: climate and standing load have one truth.
        loads = Part.CLIMATE, Part.STANDING
        groups: list[tuple[Part, ...]] = [(part,) for part in Part if part not in loads]
        groups += [loads, CLIMB, tuple(list(Part)[WHOLE])]
        groups += [group for group in breakdown.together() if group not in groups]
        for group in groups:
            amount = breakdown.of(*group)
            true = sum(truth[part.name.lower()] for part in group) / JOULES_PER_KWH
            yield PartCheck(
                drive.vehicle.key,
                drive.kind.value,
                drive.seed,
                "+".join(part.name.lower() for part in group),
                amount.kwh,
                amount.sigma_kwh,
                true,
                breakdown.total().kwh,
            )


def difference_checks(
    vehicles: Sequence[str], seeds: Iterable[int], *, seconds: float, altitude: bool
) -> Iterator[PartCheck]:
    """Two drives of one car per seed: each part of their difference, per 100 km, and the truth.

    By turns both on mixed roads, and one in town with one on a motorway.
    """
    for number, seed in enumerate(seeds):
        vehicle = load_vehicle(vehicles[number % len(vehicles)])
        wish = prior_parameters(vehicle, np.random.default_rng(seed))._asdict()
        unlike = DriveKind.URBAN, DriveKind.HIGHWAY
        kinds = unlike if number % 2 else (DriveKind.MIXED, DriveKind.MIXED)
        car, truths = LearnedCar.new(Equation(vehicle)), []
        for drive_seed, kind in enumerate(kinds, start=2 * seed):
            drive = simulate(
                *(kind, vehicle, seconds, drive_seed),
                car=wish,
                can_profile=PROFILE,
                altitude=altitude,
            )
            chain = SpanChain(vehicle, car.begin_drive(compare=True))
            chain.add_readings(drive.readings)
            car = chain.car
            truths.append(true_parts(drive.car, drive.trace, chain.spans))
        breakdowns = car.breakdowns()
        if len(breakdowns.drives) < len(kinds):
            continue
        difference = breakdowns.difference(1, 0)
        for part in Part:
            base, other = (
                truth[part.name.lower()] / whole.distance * DIFFERENCE_METRES / JOULES_PER_KWH
                for truth, whole in zip(truths, breakdowns.drives, strict=True)
            )
            amount = difference.of(part)
            total = (
                sum(breakdowns.drives[i].measured / breakdowns.drives[i].distance for i in (0, 1))
                / 2
            )
            yield PartCheck(
                vehicle=vehicle.key,
                kind="+".join(kind.value for kind in kinds),
                seed=seed,
                name=part.name.lower(),
                kwh=amount.kwh,
                sigma_kwh=amount.sigma_kwh,
                true_kwh=other - base,
                total_kwh=total * DIFFERENCE_METRES / JOULES_PER_KWH,
            )


@dataclass(frozen=True, slots=True)
class PartSummary:
    """One part over many drives; percent are of a drive's energy, except for the coverage.

    `deviation` is the root mean square of the errors in sigmas: 1 if sigmas are right.
    """

    name: str
    drives: int
    coverage_percent: float
    coverage_90_percent: float
    deviation: float
    share_percent: float
    bias_percent: float
    rms_percent: float
    sigma_percent: float


def part_summaries(checks: Iterable[PartCheck]) -> list[PartSummary]:
    """Coverage and errors of each part; joined parts are last."""
    parts: dict[str, list[PartCheck]] = {}
    for check in checks:
        parts.setdefault(check.name, []).append(check)
    return [_summary(name, group) for name, group in parts.items()]


def _summary(name: str, group: list[PartCheck]) -> PartSummary:
    rows = [(check.kwh, check.sigma_kwh, check.total_kwh, check.true_kwh) for check in group]
    kwh, sigma, total, true = np.array(rows).T
    error = kwh - true
    return PartSummary(
        name=name,
        drives=len(group),
        coverage_percent=100.0 * float(np.mean([check.covered for check in group])),
        coverage_90_percent=100.0
        * float(np.mean([check.within(GAUSSIAN_QUANTILE) for check in group])),
        deviation=float(np.sqrt(np.mean((error / np.maximum(sigma, 1e-12)) ** 2))),
        share_percent=100.0 * float(np.mean(true / total)),
        bias_percent=100.0 * float(np.mean(error / total)),
        rms_percent=100.0 * float(np.sqrt(np.mean((error / total) ** 2))),
        sigma_percent=100.0 * float(np.median(sigma / total)),
    )


def part_powers(car: Car, trace: Trace) -> Mapping[str, np.ndarray]:
    """Power of each part, W, shape (n,): they add up to `trace.power`.

    No load of a simulated car is heating or cooling: all of it is standing load. `regained`, the
    energy that braking returned to the battery, is not part of the sum.
    """
    motion = trace.motion
    driving = trace.wheel_power > 0.0
    inertia = car.mass * car.rotating_mass_factor * motion.acceleration
    brakes = trace.friction_power + np.where(driving, 0.0, trace.load_loss)
    return {
        "air": trace.drag_power,
        "tyres": trace.rolling_power,
        "slope": car.mass * GRAVITY * np.sin(motion.grade) * motion.speed,
        "speed": inertia * motion.speed,
        "brakes": brakes,
        "drivetrain": trace.no_load_loss + np.where(driving, trace.load_loss, 0.0),
        "climate": np.zeros_like(motion.speed),
        "standing": trace.auxiliary,
        "regained": np.where(driving, 0.0, -trace.wheel_power - brakes),
    }


def true_parts(
    car: Car, trace: Trace, spans: Iterable[tuple[float, float]]
) -> Mapping[str, float]:
    """Energy of each part, J, over spans of the drive, each from and to s since its start."""
    begins, ends = np.array(list(spans)).reshape(-1, 2).T / STEP

    def energy(power: np.ndarray) -> float:
        total = np.concatenate(([0.0], np.cumsum(power))) * STEP
        steps = np.arange(len(total))
        return float(np.sum(np.interp(ends, steps, total) - np.interp(begins, steps, total)))

    return {name: energy(power) for name, power in part_powers(car, trace).items()}
