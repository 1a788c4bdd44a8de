"""Estimates of a method against the truth of simulated cars, and of one on a dynamometer.

`mass_over_eta` kg, `regeneration` (eta mu), `rolling_over_eta` (C_rr m/eta, kg),
`drag_area_over_eta` (A C_d/eta, m^2) by the definitions of `simulation.truth`; `p_aux` W is the
load of the standing car, without the losses of a turning drivetrain.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
import math
from typing import Any, NamedTuple

import numpy as np

from benchmarks.truth import PROFILE, VEHICLES, simulated_drives
from benchmarks.unseen.method import NAMES, Estimate, Factory
from evpinn_ros.core.estimation.network import reference_driving
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.physics import GRAVITY
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import EPOCH_NS, SimulatedDrive, simulate

KINDS = {
    "truth_town": DriveKind.URBAN,
    "truth_mixed": DriveKind.MIXED,
    "truth_motorway": DriveKind.HIGHWAY,
}
DRIVES, SECONDS, FIRST_SEED = 12, 600.0, 9000
QUANTILE_95 = 1.96
# One of our simulated cars on many drives: vehicle file, seed and number of drives.
CARRIED_VEHICLE, CARRIED_SEED, CARRIED_DRIVES = "nissan_leaf", 9100, 8
ETA = 0.92
DENSITY = 1.2  # kg/m^3 of the given drag
KMH_PER_MPS = 3.6


class Error(NamedTuple):
    """An estimate against the truth."""

    percent: float  # of the truth
    absolute: float  # in the unit of the quantity
    # whether the 95 % interval holds the truth; where only positive values are possible it is an
    # interval of the logarithm
    covered: bool


def errors(estimates: Mapping[str, Estimate], truth: Mapping[str, float]) -> dict[str, Error]:
    """Errors of a method's estimates, by name, where the truth is known."""
    known = [name for name in NAMES if name in estimates and name in truth]
    return {name: _error(name, estimates[name], truth[name]) for name in known}


def truth_summary(drives: Sequence[Mapping[str, Error]]) -> dict[str, dict[str, Any]]:
    """Bias, median size of the error and coverage of each quantity over drives."""
    summary = {}
    for name in NAMES:
        rows = [drive[name] for drive in drives if name in drive]
        if rows:
            percent = np.array([row.percent for row in rows])
            summary[name] = {
                "drives": len(rows),
                "bias_percent": round(float(np.mean(percent)), 3),
                "median_percent": round(float(np.median(np.abs(percent))), 3),
                "bias": float(f"{np.mean([row.absolute for row in rows]):.4g}"),
                "covered_percent": round(100 * float(np.mean([row.covered for row in rows])), 1),
            }
    return summary


def run_truth(key: str, factory: Factory) -> dict[str, dict[str, Any]]:
    """Let a fresh method learn each of `DRIVES` drives, each of another car."""
    rows = []
    for drive in truth_drives(key):
        method = factory(drive.vehicle)
        for reading in drive.readings:
            for _ in method.add_reading(reading) or ():
                pass
        rows.append(errors(method.combinations(), true_combinations(drive)))
    return truth_summary(rows)


@lru_cache(maxsize=1)
def truth_drives(key: str) -> tuple[SimulatedDrive, ...]:
    """The drives of a kind, of cars of three models in turn; no height, as on most cars."""
    seeds = range(FIRST_SEED, FIRST_SEED + DRIVES)
    return tuple(simulated_drives([KINDS[key]], VEHICLES, seeds, SECONDS))


def carried_drives() -> Iterator[tuple[Reading, ...]]:
    """Drives of one car in town, mixed, on the motorway in turn; with height and temperature."""
    vehicle, kinds = load_vehicle(CARRIED_VEHICLE), tuple(KINDS.values())
    car = None
    for number in range(CARRIED_DRIVES):
        drive = simulate(
            kinds[number % len(kinds)],
            vehicle,
            SECONDS,
            CARRIED_SEED + number,
            car=car,
            can_profile=PROFILE,
            altitude=True,
            temperature=True,
            start_ns=EPOCH_NS + number * 86_400 * NANOSECONDS,
        )
        car = drive.car
        yield drive.readings


def true_combinations(drive: SimulatedDrive) -> dict[str, float]:
    """The truth of a simulated drive."""
    combinations = drive.truth.identifiable
    return {
        "mass_over_eta": float(combinations.mass_over_eta),
        "regeneration": float(combinations.regeneration),
        "rolling_over_eta": float(combinations.c_rr * combinations.mass_over_eta),
        "drag_area_over_eta": float(combinations.drag_area_over_eta),
        "p_aux": float(np.mean(drive.trace.auxiliary)),
    }


def _error(name: str, estimate: Estimate, truth: float) -> Error:
    value, std = estimate
    if name == "p_aux":
        covered = abs(value - truth) <= QUANTILE_95 * std
    else:
        covered = value > 0 and abs(math.log(value / truth)) <= QUANTILE_95 * std / value
    return Error(100 * (value / truth - 1), value - truth, covered)


def dynamometer_truth(mass: float, force: tuple[float, float, float]) -> dict[str, float]:
    """Combinations by `method.NAMES` but for braking and standing load.

    The mass is the inertia that was set, and the road load the force that was set, nearest to
    which C_rr m g + rho/2 C_d A v^2 comes over the way of standard driving. No dynamometer
    measures the efficiency: `ETA`, of the inverter, motor and gears of an electric car, is the
    base of the combinations (m/eta of these drives by another method: 2075 +- 30 kg).

    Args:
        mass: set, kg.
        force: set, N by powers of speed in km/h.
    """
    driving = reference_driving()
    speed, weight = driving.speed, np.sqrt(driving.seconds * driving.speed)
    wanted = np.polynomial.polynomial.polyval(speed * KMH_PER_MPS, force)
    terms = np.stack((np.full_like(speed, GRAVITY), DENSITY / 2.0 * speed**2), axis=1)
    solution = np.linalg.lstsq(weight[:, None] * terms, weight * wanted, rcond=None)[0]
    rolling, area = (solution / ETA).tolist()
    return {
        "mass_over_eta": mass / ETA,
        "rolling_over_eta": rolling,
        "drag_area_over_eta": area,
    }


# Electric sedan of Jilin University (Yuan et al., Patterns 2024), as its data set tells.
CHANGCHUN = dynamometer_truth(1919.0, (179.4, 0.28, 0.0235))
