"""The floor of the data: how well a drive can tell the parameters to one who knows all else.

The oracle knows the equations, each loss, the wind, the auxiliary load and the whole drive, future
included; it is asked only for m/eta, C_rr, eta mu and A C_d/eta, of which it has the priors of the
vehicle file, and does not know the hills. Battery power is then linear in what it is asked and in
the slope of the road, so the posterior covariance is exact (the Bayesian Cramer-Rao bound): no
estimator that knows less does better on average.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
import math

import numpy as np

from benchmarks.truth import simulated_drives
from evpinn_ros.simulation.drive import SAMPLE_RATE, DriveKind
from evpinn_ros.simulation.road import LONGEST_HILL, SHORTEST_HILL
from evpinn_ros.simulation.sensors import (
    ALTITUDE_DRIFT,
    ALTITUDE_DRIFT_MEMORY,
    ALTITUDE_NOISE,
    ALTITUDE_RATE,
)
from evpinn_ros.simulation.simulate import RMS_GRADE, SimulatedDrive
from evpinn_ros.simulation.truth import PLAUSIBLE_SPREAD
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.physics import (
    GRAVITY,
    STANDSTILL_SPEED,
    drag_force,
    grade_force,
    inertia_force,
    rolling_force,
)

ASKED = ("mass_over_eta", "c_rr", "regeneration", "drag_area_over_eta")
SAMPLES = 2.0  # Hz: sensors' errors are alike for half a second
POWER_NOISE = 90.0  # W, of half a second of voltage and current with the simulated noise
FORCE_NOISE = 40.0  # N over eta: an acceleration known to 0.02 m/s^2
WAVES = 80  # wavelengths that stand for all between the shortest and the longest hill
UNKNOWN_ALTITUDE = 100.0  # m, 1-sigma of that of the start
MEDIAN = 0.6745  # of the size of a normal deviate


def floors(
    kind: DriveKind,
    vehicles: Sequence[str],
    seeds: Iterable[int],
    *,
    seconds: float = 120.0,
    rms_grade: float = RMS_GRADE,
    altitude: bool = False,
) -> Iterator[Mapping[str, float]]:
    """`median_floor` of the drives that `benchmarks.truth.compare` has."""
    for drive in simulated_drives([kind], vehicles, seeds, seconds, rms_grade=rms_grade):
        yield median_floor(drive, seconds, rms_grade, altitude=altitude)


def median_floor(
    drive: SimulatedDrive, seconds: float, rms_grade: float, *, altitude: bool = False
) -> Mapping[str, float]:
    """Least median error of the first seconds of a drive, percent, of each of `ASKED`.

    The drive is one by `simulate` on a road of `rms_grade`, which the oracle knows, 0 for slopes
    that are known exactly; `altitude` gives it the barometer.
    """
    count, every = round(seconds * SAMPLE_RATE), round(SAMPLE_RATE / SAMPLES)
    motion = drive.trace.motion
    speed = motion.speed[:count]
    distance = np.cumsum(speed) / SAMPLE_RATE
    moving = np.flatnonzero(speed > STANDSTILL_SPEED)[::every]
    asked, by_slope, sigma = _gradient(drive, moving)
    waves, heights = _hills(distance, max(rms_grade, 1e-9))
    design = np.hstack((asked, by_slope[:, None] * waves[moving])) / sigma[:, None]
    prior = np.append(_prior_std(drive.vehicle), np.ones(waves.shape[1]))
    information = design.T @ design + np.diag(prior**-2.0)
    if altitude:
        information[len(ASKED) :, len(ASKED) :] += _barometer(motion.time[:count], heights)
    variance = np.diag(np.linalg.inv(information))[: len(ASKED)]
    return dict(zip(ASKED, (100.0 * MEDIAN * np.sqrt(variance)).tolist(), strict=True))


def _gradient(drive: SimulatedDrive, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """DP by the logarithms of `ASKED`, (n, 4), dP by slope, (n,), both W, and sigma, (n,), W."""
    car, motion, p = drive.car, drive.trace.motion, drive.truth.parameters
    speed = motion.speed[at]
    drag = drag_force(speed, car.frontal_area * p.c_d, car.air_density)
    rolling = rolling_force(p.mass, p.c_rr)
    inertia = inertia_force(p.mass * car.rotating_mass_factor, motion.acceleration[at])
    force = drag + rolling + inertia + grade_force(p.mass, motion.grade[at])
    driving = force > 0
    share = np.where(driving, 1 / p.eta, p.mu) * speed
    columns = (
        share * (force - drag),
        share * rolling,
        np.where(driving, 0.0, share * force),
        share * drag,
    )
    sigma = np.hypot(POWER_NOISE, FORCE_NOISE / p.eta * speed)
    return np.stack(columns, axis=1), share * p.mass * GRAVITY, sigma


def _hills(distance: np.ndarray, rms_grade: float) -> tuple[np.ndarray, np.ndarray]:
    """Slope and height, m, along the road by each of 2 `WAVES` unit normal unknowns, (n, 160).

    The simulated road has twelve of these waves, drawn at random: the same spectrum.
    """
    lengths = np.exp(np.linspace(math.log(SHORTEST_HILL), math.log(LONGEST_HILL), WAVES))
    number = 2 * np.pi / lengths
    size = rms_grade / math.sqrt(WAVES)
    phase = np.outer(distance, number)
    slopes = np.hstack((np.cos(phase), np.sin(phase)))
    heights = np.hstack((np.sin(phase) / number, -np.cos(phase) / number))
    return size * slopes, size * heights


def _barometer(time: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Information of the barometer's readings on the hills, shape (160, 160)."""
    at = np.arange(0, time.size, round(SAMPLE_RATE / ALTITUDE_RATE))
    apart = np.abs(time[at][:, None] - time[at])
    noise = ALTITUDE_DRIFT**2 * np.exp(-apart / ALTITUDE_DRIFT_MEMORY) + UNKNOWN_ALTITUDE**2
    noise += ALTITUDE_NOISE**2 * np.eye(at.size)
    return np.asarray(heights[at].T @ np.linalg.solve(noise, heights[at]))


def _prior_std(vehicle: Vehicle) -> np.ndarray:
    """1-sigma of the logarithms of `ASKED` before driving, shape (4,).

    That of C_rr is of the cars as they are drawn, normal within `PLAUSIBLE_SPREAD` sigmas.
    """
    std = {name: prior.std / prior.value for name, prior in vehicle.priors.items()}
    ends = PLAUSIBLE_SPREAD
    density = math.exp(-(ends**2) / 2) / math.sqrt(2 * math.pi)
    drawn = math.sqrt(1 - 2 * ends * density / math.erf(ends / math.sqrt(2)))
    return np.array(
        (
            math.hypot(std["mass"], std["eta"]),
            drawn * std["c_rr"],
            math.hypot(std["eta"], std["mu"]),
            math.hypot(std["c_d"], std["eta"]),
        )
    )
