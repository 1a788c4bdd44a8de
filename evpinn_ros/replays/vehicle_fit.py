"""Checks whether a drive contradicts its vehicle file."""

from __future__ import annotations

from collections.abc import Iterator
import math

from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.core.vehicle.certified import certified_cars
from evpinn_ros.core.vehicle.files import GENERIC, Vehicle, load_vehicle
from evpinn_ros.core.vehicle.identifiable import prior_identifiable
from evpinn_ros.core.vehicle.rated import rated_cars
from evpinn_ros.replays.driven import charged, measured_steps
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.run import WARM_UP

DOUBTFUL = 3.0  # sigmas from the expectation of the vehicle file
LEAST_DISCHARGE = 0.1  # share of the battery from which on its size is known
LEAST_MEASURED = 0.95  # share of the drive with the battery measured
USUAL_CAPACITY = (0.6, 1.4)  # over that of the file: age, cold, and a nonlinear gauge
MOST_RIVALS = 3


def vehicle_doubt(vehicle: Vehicle, drive: Drive) -> str | None:
    """Sentence on a contradiction of the vehicle file; None without one, or on a short drive."""
    if vehicle.key == GENERIC or drive.duration <= WARM_UP:
        return None
    reasons = [*_mass_reason(vehicle, drive), *_capacity_reason(vehicle, drive)]
    if not reasons:
        return None
    rivals = ", ".join(_rivals(drive))
    advice = f"--vehicle {GENERIC}{rivals and f', or one of {rivals}'}"
    return f"This log does not look like a {vehicle.name}: {' and '.join(reasons)}. Try {advice}."


def size_note(vehicle: Vehicle, drive: Drive) -> str | None:
    """Sentence on a learned size of the vehicle that is not that of its file, else None."""
    learned_as = vehicle if drive.model is None else drive.model.equation.vehicle
    if learned_as.relative_size == vehicle.relative_size:
        return None
    mass = float(f"{learned_as.initial.mass:.2g}")
    return (
        f"Learned as a vehicle of about {mass:.0f} kg, from wide priors: no --vehicle was given, "
        "and energy, accelerations and voltage are not those of a passenger car."
    )


def _mass_reason(vehicle: Vehicle, drive: Drive) -> Iterator[str]:
    rows = drive.combinations.get("mass_over_eta")
    if rows is None or not len(rows):
        return
    _, value, std = rows[-1].tolist()
    expected, spread = (sums.mass_over_eta for sums in prior_identifiable(vehicle))
    if abs(value - expected) > DOUBTFUL * math.hypot(std, spread):
        yield (
            f"mass divided by efficiency is {value:.0f} kg ({expected:.0f} +- {spread:.0f} "
            "expected)"
        )


def capacity_by_charge(drive: Drive) -> float | None:
    """Capacity from the drop of the state of charge, J; None if charged, small or with gaps."""
    if len(drive.charge) < 2 or charged(drive):
        return None
    used = float(drive.charge[0, 1] - drive.charge[-1, 1])
    steps = measured_steps(drive)
    if used < LEAST_DISCHARGE or steps.seconds.sum() < LEAST_MEASURED * drive.duration:
        return None
    return float(steps.energy.sum()) / used


def _capacity_reason(vehicle: Vehicle, drive: Drive) -> Iterator[str]:
    capacity = capacity_by_charge(drive)
    if capacity is None or not math.isfinite(vehicle.battery_capacity):
        return
    low, high = (share * vehicle.battery_capacity for share in USUAL_CAPACITY)
    if not low <= capacity <= high:
        kwh, expected = capacity / JOULES_PER_KWH, vehicle.battery_capacity / JOULES_PER_KWH
        yield f"its battery holds {kwh:.0f} kWh by charge and energy ({expected:.0f} expected)"


def _rivals(drive: Drive) -> Iterator[str]:
    """Known models whose mass over eta is nearest to the learned one, the nearest first."""
    rows = drive.combinations.get("mass_over_eta")
    if rows is None or not len(rows):
        return
    value = float(rows[-1, 1])

    def distance(key: str) -> float:
        expected, spread = (sums.mass_over_eta for sums in prior_identifiable(load_vehicle(key)))
        return abs(value - float(expected)) / float(spread)

    near = sorted((distance(key), key) for key in (*certified_cars(), *rated_cars()))
    yield from (key for away, key in near[:MOST_RIVALS] if away < 1.0)
