"""Accuracy of counted energy: quadrature, gaps, battery dropouts, the distance to empty.

Recorded drives go through the chain in order, as on board: what was learned is carried over. At
every `STRIDE` of a drive a copy of the chain goes on without the battery for `DROPOUT`, and one
goes through the whole drive without it; their counts are compared with the battery, which the
benchmark measures all along. Energy errors are relative to the gross energy (drawn and
regenerated together) that the battery gave over the same time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
import copy
from itertools import accumulate
import math
from typing import NamedTuple

import numpy as np

from benchmarks.logs import Log
from evpinn_ros.drives.sources import open_source
from evpinn_ros.energy.charge import ChargeGauge, Uncertain
from evpinn_ros.energy.meter import EnergyMeter, Integrator
from evpinn_ros.energy.quadrature import EnergyIntegral
from evpinn_ros.energy.remaining import QUANTILE, Cost, cost_spread, remaining
from evpinn_ros.energy.rknn import load_rknn
from evpinn_ros.energy.trip import Stretch, TripLog
from evpinn_ros.energy.uncertainty import LASTING_SHARE
from evpinn_ros.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.estimation.estimator import EstimatorSettings
from evpinn_ros.estimation.worker import Clock, InlineWorker
from evpinn_ros.replays.chain import Chain
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.simulation.drive import SAMPLE_RATE, DriveKind
from evpinn_ros.simulation.simulate import simulate
from evpinn_ros.vehicle.files import Vehicle, load_vehicle

DAY = 24 * 3600  # s
STRIDE, DROPOUT = 150.0, 600.0  # s
SIMULATED_TIME = 1800.0  # s of each simulated drive
SEED = 0
GAP_SHARE, LONGEST_GAP = 0.1, 20  # of the seconds of a 1 Hz battery; s
NOISE, NOISE_TIME = 1e3, 0.5  # 1-sigma, W, and correlation time, s, of predictions of real drives
PERIODS = (1, 5)  # s of slow batteries
HORIZONS = (10e3, 20e3, 40e3)  # m


class IntegrationRow(NamedTuple):
    """One figure."""

    name: str  # of what
    figure: float  # its value
    unit: str  # of it; `%` is of gross energy where energies are compared
    cases: int  # it is made of
    goal: str = ""  # in words, empty without one


class Counted(NamedTuple):
    """Energy of one stretch of a drive without its battery, J."""

    error: float  # of what was counted
    sigma: float  # what the meter says of that
    gross: float  # what the battery gave over the stretch, drawn and regenerated together
    gross_so_far: float  # the same since the start of the drive


def integration_rows(cars: Iterable[Sequence[Log]], clock: Clock) -> list[IntegrationRow]:
    """All figures.

    Each car has its drives in order (`benchmarks.logs.find_logs`); the clock times updates.
    """
    rows = [day_row(), *simulated_rows()]
    for logs in cars:
        rows += _car_rows(list(logs), clock)
    return rows


def day_row() -> IntegrationRow:
    """Drift of the integral over a day of 10 Hz against the exact sum of the same steps."""
    power = 8e3 + 15e3 * np.random.default_rng(SEED).standard_normal(DAY * 10 + 1)
    integral, terms = EnergyIntegral(), []
    for tick, watts in enumerate(power.tolist()):
        step = integral.append(tick * NANOSECONDS // 10, watts)
        if step is not None:
            terms.append(step.energy)
    exact = math.fsum(terms)
    drift = abs(integral.energy - exact) / abs(exact)
    return IntegrationRow("drift in 24 h at 10 Hz", drift, "1", 1, "<= 1e-6")


def simulated_rows() -> Iterator[IntegrationRow]:
    """Samples of simulated drives against all of their 100 Hz."""
    errors, gappy = [], []
    for kind in DriveKind:
        power = simulate(kind, load_vehicle("tesla_model_3_lr"), SIMULATED_TIME, SEED).trace.power
        exact, coarse = (
            _integral(np.arange(0, len(power), skip) / SAMPLE_RATE, power[::skip])
            for skip in (1, 10)
        )
        errors.append(abs(coarse - exact) / abs(exact))
        gappy.append(100 * abs(_metered(power) - exact) / abs(exact))
    yield IntegrationRow(
        "quadrature of 10 Hz against 100 Hz, worst drive", max(errors), "1", len(errors), "<= 1e-4"
    )

    name = f"1 Hz with {GAP_SHARE:.0%} missing, predicted 6 % and 1 kW wrong, against 100 Hz: "
    yield from _spread_rows(name, gappy, "<= 0.5 %")


def _metered(power: np.ndarray) -> float:
    """Energy, J, that a meter counts of a battery at 1 Hz of which a tenth is missing."""
    meter, random = EnergyMeter(load_rknn()), np.random.default_rng(SEED)
    kept, noise = math.exp(-10 / SAMPLE_RATE / NOISE_TIME), 0.0
    for index in range(0, len(power), 10):
        stamp_ns, watts = index * NANOSECONDS // SAMPLE_RATE, float(power[index])
        if index % SAMPLE_RATE == 0 and (index == 0 or random.random() > GAP_SHARE):
            meter.add_measured(stamp_ns, watts, 0.0)
        noise = kept * noise + NOISE * math.sqrt(1 - kept**2) * random.standard_normal()
        meter.add_predicted(stamp_ns, (1 + LASTING_SHARE) * watts + noise, NOISE)
    return meter.state.consumed


def _integral(time: np.ndarray, power: np.ndarray) -> float:
    integral = EnergyIntegral()
    for t, watts in zip(time.tolist(), power.tolist(), strict=True):
        integral.append(round(t * NANOSECONDS), watts)
    return integral.energy


def _car_rows(logs: Sequence[Log], clock: Clock) -> Iterator[IntegrationRow]:
    vehicle = load_vehicle(logs[0].vehicle)
    drives = list(_measured_drives(logs, vehicle))
    if not drives:
        return
    dropouts, whole, slow = _through_the_chain(vehicle, drives, clock)
    name = vehicle.key
    yield from _error_rows(f"{name}, battery dropout of {DROPOUT:g} s", dropouts, "<= 3 %")
    so_far = [abs(100 * one.error / one.gross_so_far) for one in dropouts if one.gross_so_far > 0]
    if so_far:
        text = f"{name}, the same of the gross energy since the start of the drive: "
        yield from _spread_rows(text, so_far, "<= 3 %")
    yield from _error_rows(f"{name}, whole drives without the battery, after the first", whole[1:])
    for (period, integrator), gappy in slow.items():
        text = f"{name}, battery every {period} s with {GAP_SHARE:.0%} in gaps, {integrator}: "
        yield from _spread_rows(text, gappy, "<= 0.5 %" if period == 1 else "")
    yield from _range_rows(name, drives)
    yield from _capacity_rows(name, vehicle, drives)


def _measured_drives(logs: Sequence[Log], vehicle: Vehicle) -> Iterator[list[Reading]]:
    """The drives on which the battery gave or took any energy."""
    for log in logs:
        readings = list(open_source(log.path, vehicle, log.can_profile).readings())
        if readings and _battery(readings, 0, readings[-1].stamp_ns).gross > 0:
            yield readings


def _error_rows(name: str, found: Sequence[Counted], goal: str = "") -> Iterator[IntegrationRow]:
    found = [one for one in found if one.gross > 0]
    if not found:
        return
    yield from _spread_rows(f"{name}: ", [abs(100 * one.error / one.gross) for one in found], goal)
    covered = [abs(one.error) <= QUANTILE * one.sigma for one in found]
    share = 100 * float(np.mean(covered))
    yield IntegrationRow(f"{name}: in the 90 % band", share, "%", len(found), "85 to 95 %")


def _spread_rows(name: str, errors: Sequence[float], goal: str = "") -> Iterator[IntegrationRow]:
    for quantile, word in ((0.5, "median"), (0.9, "90 % of them"), (1.0, "worst")):
        figure = float(np.quantile(errors, quantile))
        yield IntegrationRow(name + word, figure, "%", len(errors), goal)


def _through_the_chain(
    vehicle: Vehicle, drives: Sequence[Sequence[Reading]], clock: Clock
) -> tuple[list[Counted], list[Counted], dict[tuple[int, str], list[float]]]:
    """Dropouts, whole drives without the battery, and errors in % of a slow one with gaps."""
    dropouts: list[Counted] = []
    whole: list[Counted] = []
    slow: dict[tuple[int, str], list[float]] = {}
    chain = Chain(vehicle, EstimatorSettings(), InlineWorker(clock))
    for readings in drives:
        whole.append(_without_battery(chain, readings, 0, math.inf))
        for period in PERIODS:
            for integrator, error in _with_gaps(chain, readings, period).items():
                slow.setdefault((period, integrator), []).append(error)
        start_ns, end_ns = readings[0].stamp_ns, readings[-1].stamp_ns
        next_ns = start_ns + round(STRIDE * NANOSECONDS)
        for index, reading in enumerate(readings):
            if reading.stamp_ns >= next_ns and end_ns - next_ns >= DROPOUT * NANOSECONDS:
                dropouts.append(_without_battery(chain, readings, index, DROPOUT))
                next_ns += round(STRIDE * NANOSECONDS)
            for _ in chain.add_reading(reading):
                pass
        chain.begin_next_drive()
    return dropouts, whole, slow


def _without_battery(
    chain: Chain, readings: Sequence[Reading], begin: int, seconds: float
) -> Counted:
    """Count of a copy of the chain from a reading on, the battery withheld."""
    fork = copy.deepcopy(chain)
    before = fork.account.state
    begin_ns = readings[begin].stamp_ns
    for reading in readings[begin:]:
        if reading.stamp_ns - begin_ns > seconds * NANOSECONDS:
            break
        if not isinstance(reading, BatteryReading):
            for _ in fork.add_reading(reading):
                pass
    after = fork.account.state
    # From the battery's last word, or the first prediction, to the last prediction.
    begin_ns = max(before.stamp_ns, begin_ns)
    truth = _battery(readings, begin_ns, after.stamp_ns)
    so_far = _battery(readings, readings[0].stamp_ns, after.stamp_ns)
    error = after.consumed - before.consumed - truth.energy
    sigma = math.sqrt(max(after.consumed_sigma**2 - before.consumed_sigma**2, 0.0))
    return Counted(error, sigma, truth.gross, so_far.gross)


def _with_gaps(chain: Chain, readings: Sequence[Reading], period: int) -> dict[str, float]:
    """Errors, % of gross energy, of a copy of the chain whose battery is slow and has gaps.

    The chain knows what was learned on the drives before; the period of the battery is in s.

    Returns:
        By integrator: both count what one estimator says.
    """
    estimator = copy.deepcopy(chain.estimator)
    meters = {each: EnergyMeter(load_rknn(), integrator=each) for each in Integrator}
    measures, used_s = _measured_seconds(readings), -NANOSECONDS
    measures &= np.arange(len(measures)) % period == 0
    for reading in readings:
        if isinstance(reading, BatteryReading):
            second = (reading.stamp_ns - readings[0].stamp_ns) // NANOSECONDS
            if second == used_s or not measures[second]:
                continue
            used_s = second
        for output in estimator.add_reading(reading):
            if not isinstance(output, PowerEstimate) or output.kind is PowerKind.PREDICTED:
                continue
            for meter in meters.values():
                measured = output.kind is PowerKind.MEASURED
                add = meter.add_measured if measured else meter.add_predicted
                add(output.stamp_ns, output.power, output.sigma)
    states = {each.value: meter.state for each, meter in meters.items()}
    truth = _battery(readings, readings[0].stamp_ns, next(iter(states.values())).stamp_ns)
    return {
        name: abs(100 * (state.consumed - truth.energy) / truth.gross)
        for name, state in states.items()
    }


def _measured_seconds(readings: Sequence[Reading]) -> np.ndarray:
    """Mask of the seconds of a drive in which the battery is measured, shape (n,)."""
    random = np.random.default_rng(SEED)
    seconds = (readings[-1].stamp_ns - readings[0].stamp_ns) // NANOSECONDS + 1
    measures = np.ones(seconds, dtype=bool)
    while np.mean(~measures) < GAP_SHARE:
        start = random.integers(seconds)
        measures[start : start + random.integers(1, LONGEST_GAP + 1)] = False
    return measures


def _battery(readings: Sequence[Reading], begin_ns: int, end_ns: int) -> EnergyIntegral:
    """Integral of the battery's power between two stamps."""
    integral = EnergyIntegral()
    for reading in readings:
        if isinstance(reading, BatteryReading) and begin_ns <= reading.stamp_ns <= end_ns:
            integral.append(reading.stamp_ns, reading.power)
    return integral


def _range_rows(name: str, drives: Sequence[Sequence[Reading]]) -> Iterator[IntegrationRow]:
    """Is the road that a known energy did last for in the band of the distance to empty?"""
    pieces = list(_kilometres(drives))
    energies = list(accumulate((piece.energy for piece in pieces), initial=0.0))
    distances = list(accumulate((piece.distance for piece in pieces), initial=0.0))
    for horizon in HORIZONS:
        log, inside, errors = TripLog(), [], []
        for index, piece in enumerate(pieces):
            for window in log.windows:
                window.add(piece)
            end = next(
                (i for i, d in enumerate(distances) if d - distances[index + 1] >= horizon), None
            )
            if not log.windows[1].known or end is None:
                continue
            recent, long = log.windows[1].total, log.windows[2].total
            cost = Cost.ahead(
                recent.energy / recent.distance,
                long.energy / long.distance,
                math.nan,  # no car is learned here
                cost_spread(log.windows[2].whole),
            )
            left = Uncertain(energies[end] - energies[index + 1], 0.0)
            estimate = remaining(left, cost)
            driven = distances[end] - distances[index + 1]
            if estimate is not None:
                inside.append(estimate.lower <= driven <= estimate.upper)
                errors.append(abs(100 * (estimate.distance / driven - 1)))
        if inside:
            text = f"{name}, distance to empty {horizon / 1e3:g} km ahead: "
            yield IntegrationRow(text + "median error", float(np.median(errors)), "%", len(errors))
            share = 100 * float(np.mean(inside))
            yield IntegrationRow(text + "in the 90 % band", share, "%", len(inside))


def _kilometres(drives: Sequence[Sequence[Reading]]) -> Iterator[Stretch]:
    """All drives as one road, in pieces of a kilometre or a little more."""
    for readings in drives:
        energy, road, last = EnergyIntegral(), EnergyIntegral(), Stretch(0.0, 0.0)
        for reading in readings:
            if isinstance(reading, BatteryReading):
                energy.append(reading.stamp_ns, reading.power)
            elif isinstance(reading, SpeedReading):
                road.append(reading.stamp_ns, abs(reading.speed))
            if road.drawn - last.distance >= 1e3:
                here = Stretch(road.drawn, energy.energy)
                yield Stretch(here.distance - last.distance, here.energy - last.energy)
                last = here


def _capacity_rows(
    name: str, vehicle: Vehicle, drives: Sequence[Sequence[Reading]]
) -> Iterator[IntegrationRow]:
    """The capacity learned over all drives, the energy of each counted on from the last."""
    gauge, before = ChargeGauge(vehicle.battery_capacity), 0.0
    for readings in drives:
        integral = EnergyIntegral()
        gauge.begin_anew()
        for reading in readings:
            if isinstance(reading, BatteryReading):
                integral.append(reading.stamp_ns, reading.power)
                taken = Uncertain(before + integral.energy, 0.0)
                gauge.update(reading.stamp_ns, reading.state_of_charge, taken, 0.0)
        before += integral.energy
    if gauge.learned:
        for word, joules in (("", gauge.capacity.value), (", 1-sigma", gauge.capacity.sigma)):
            yield IntegrationRow(
                f"{name}, learned capacity{word}", joules / 3.6e6, "kWh", gauge.learned
            )
