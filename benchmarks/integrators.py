"""The paper's Runge-Kutta network beside a plain one and two rules, on the same samples of power.

Truth is the integral of a straight line through every sample of the log (compensated sum of
trapezoids), of a simulated drive through its 100 Hz. What a car does between two samples of a
10 Hz log is unknown, so there the trapezoid is the yardstick and has no error. Errors are in
percent of the gross energy, drawn and regenerated together.

The networks as published (`reproduction.energy_network`) are trained on the car's first drive, for
each sampling anew, and asked about all of its drives. A step longer than the networks know is
divided along the straight line, so that all four know the same samples and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import simpson

from benchmarks.logs import Log
from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.sources import open_source
from evpinn_ros.energy.quadrature import MAX_GAP, EnergyIntegral
from evpinn_ros.energy.rknn import STEP_LIMIT, load_rknn
from evpinn_ros.reproduction.energy_network import MIN_STEPS, EnergyTraining, step_data
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading
from evpinn_ros.simulation.drive import SAMPLE_RATE, DriveKind
from evpinn_ros.simulation.simulate import simulate
from evpinn_ros.vehicle.files import load_vehicle

SEED = 0
MISSING = 0.1  # of the samples at 1 Hz
SIMULATED, SIMULATED_TIME = "simulated", 900.0  # s
LEAST_DURATION = 3.0 * MIN_STEPS  # s, so that 1 Hz can be trained on


class UnbrokenPower(NamedTuple):
    """Samples of power without a gap: time, s, rising, and power, W, shape (n,) each."""

    name: str
    time: np.ndarray
    power: np.ndarray


class IntegratorRow(NamedTuple):
    """Errors of one method on one sampling, over the drives of a car, % of gross energy."""

    car: str
    method: str
    sampling: str
    median: float
    worst: float
    drives: int


class IntegratorAgreement(NamedTuple):
    """Shipped network less trapezoid on every sample of a log, % of gross energy."""

    log: str
    percent: float


Sampling = Callable[[UnbrokenPower], UnbrokenPower]
Integrator = Callable[[UnbrokenPower], float]  # net energy, J


def measured_power(log: Log) -> UnbrokenPower:
    """The longest part of a log in which the battery is never silent for `MAX_GAP`.

    Raises:
        InputError: it cannot be read, or holds too little of the battery's power, or none but 0.
    """
    readings = open_source(log.path, load_vehicle(log.vehicle), log.can_profile).readings()
    found = [
        (each.stamp_ns, each.power)
        for each in readings
        if isinstance(each, BatteryReading) and math.isfinite(each.power)
    ]
    stamps, rows = np.unique(np.array([ns for ns, _ in found], np.int64), return_index=True)
    power = np.array([watts for _, watts in found])[rows]
    breaks = np.flatnonzero(np.diff(stamps) > MAX_GAP * NANOSECONDS) + 1
    longest = max(np.split(np.arange(len(stamps)), breaks), key=len)
    time, power = (stamps[longest] - stamps[longest[:1]]) / NANOSECONDS, power[longest]
    if not power.any() or time[-1] < LEAST_DURATION:
        raise InputError(f"{log.path}: no {LEAST_DURATION:g} s of power in one piece")
    return UnbrokenPower(str(log.path), time, power)


def simulated_power() -> list[UnbrokenPower]:
    """One drive of each kind at 100 Hz."""
    vehicle = load_vehicle("tesla_model_3_lr")
    traces = [(kind, simulate(kind, vehicle, SIMULATED_TIME, SEED).trace) for kind in DriveKind]
    return [
        UnbrokenPower(kind.value, np.arange(len(trace.power)) / SAMPLE_RATE, trace.power)
        for kind, trace in traces
    ]


def compare_integrators(
    car: str, drives: Sequence[UnbrokenPower], epochs: int
) -> Iterator[IntegratorRow]:
    """Each method on each sampling of one car's drives.

    The networks as published are trained on the first drive, for so many epochs.

    Raises:
        InputError: the training diverges, or the first drive is too short for it.
    """
    for sampling, sample in SAMPLINGS.items():
        errors: dict[str, list[float]] = {}
        methods = {**RULES, **_networks(sample(drives[0]), epochs)}
        for drive in drives:
            truth, samples = _integral(drive), sample(drive)
            for method, integrate in methods.items():
                error = 100 * abs(integrate(samples) - truth.energy) / truth.gross
                errors.setdefault(method, []).append(error)
        for method, found in errors.items():
            median = float(np.median(found))
            yield IntegratorRow(car, method, sampling, median, max(found), len(found))


def agreement(drive: UnbrokenPower) -> IntegratorAgreement:
    """The shipped network against the trapezoid on every sample of a log."""
    rule = _integral(drive)
    return IntegratorAgreement(drive.name, 100 * (_shipped(drive) - rule.energy) / rule.gross)


def at_most(rate: float, drive: UnbrokenPower) -> UnbrokenPower:
    """The first sample of each period, and the last of all, so that no time is lost."""
    ticks = np.floor((drive.time - drive.time[0]) * rate + 1e-6)
    rows = np.unique([*np.unique(ticks, return_index=True)[1], len(drive.time) - 1])
    return UnbrokenPower(drive.name, drive.time[rows], drive.power[rows])


def gappy(drive: UnbrokenPower) -> UnbrokenPower:
    """1 Hz, of which `MISSING` are missing by chance; the first and the last are there."""
    slow = at_most(1.0, drive)
    kept = np.random.default_rng(SEED).random(len(slow.time)) >= MISSING
    kept[[0, -1]] = True
    return UnbrokenPower(drive.name, slow.time[kept], slow.power[kept])


def divided(drive: UnbrokenPower) -> UnbrokenPower:
    """The same straight lines, with samples on them so that no step exceeds `STEP_LIMIT`."""
    pieces = np.ceil(np.diff(drive.time) / STEP_LIMIT - 1e-9).astype(int)
    time = np.interp(
        np.arange(pieces.sum() + 1), np.concatenate(([0], np.cumsum(pieces))), drive.time
    )
    return UnbrokenPower(drive.name, time, np.interp(time, drive.time, drive.power))


def _integral(drive: UnbrokenPower) -> EnergyIntegral:
    integral = EnergyIntegral(float(np.ptp(drive.time)) + 1.0)
    for time, power in zip(drive.time.tolist(), drive.power.tolist(), strict=True):
        integral.append(round(time * NANOSECONDS), power)
    return integral


def _shipped(drive: UnbrokenPower) -> float:
    known = divided(drive)
    return float(load_rknn().step(known.power[:-1], known.power[1:], np.diff(known.time)).sum())


def _networks(drive: UnbrokenPower, epochs: int) -> dict[str, Integrator]:
    """Both networks as published, trained on one drive."""
    known = divided(drive)
    training = EnergyTraining(step_data(known.time, known.power), seed=SEED)
    training.run_to(epochs)

    def network(number: int) -> Integrator:
        def integrate(other: UnbrokenPower) -> float:
            asked = divided(other)
            return float(training.integrate(asked.time, asked.power)[number][-1])

        return integrate

    return {"RKNN, as published": network(0), "DNN, as published": network(1)}


RULES: Mapping[str, Integrator] = {
    "trapezoid": lambda drive: _integral(drive).energy,
    "Simpson": lambda drive: float(simpson(drive.power, x=drive.time)),
    "RKNN, shipped": _shipped,
}
SAMPLINGS: Mapping[str, Sampling] = {
    "10 Hz": lambda drive: at_most(10.0, drive),
    "1 Hz": lambda drive: at_most(1.0, drive),
    f"1 Hz, {MISSING:.0%} missing": gappy,
}
