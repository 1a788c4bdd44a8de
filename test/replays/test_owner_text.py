"""What an owner asks first: kilometres, kilowatt hours, and what took most."""

from dataclasses import replace
from pathlib import Path
import time

import numpy as np
import pytest

import evpinn_ros as ev
from evpinn_ros.common.units import JOULES_PER_KWH, US
from evpinn_ros.core.energy.charge import ChargeGauge
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import BatteryReading
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.comparison import distance_until
from evpinn_ros.replays.driven import charged, counted, measured_steps
from evpinn_ros.replays.energy_metrics import INVALID
from evpinn_ros.replays.run import Replayed, ReplayOptions, replay
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate
from evpinn_ros.report.owner_text import health_line, owner_line
from test.recorded import Recorded

pytestmark = pytest.mark.slow
DATA = Path(__file__).parents[2].parent / "shared" / "data"
RATED = 1.4 * JOULES_PER_KWH  # a battery that minutes in town empty by tenths
NOTHING = np.empty((0, 2))


def chain_of(vehicle) -> Chain:
    return Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter))


def replayed(vehicle, readings, chain=None) -> Replayed:
    source, options = Recorded(list(readings), Path("town")), ReplayOptions(warm_up=30.0)
    chain = chain or chain_of(vehicle)
    return replay(source, chain, options, vehicle=vehicle.key, mode="hybrid")


@pytest.fixture(scope="module")
def town(vehicle, readings) -> Replayed:
    return replayed(vehicle, readings)


def test_the_line_holds_what_was_measured(town):
    km = distance_until(town.drive)[1][-1] / 1000
    kwh = measured_steps(town.drive).energy.sum() / 3.6e6
    line = owner_line(town.drive, town.metrics)
    assert line.startswith(f"{km:.1f} km in 2 min: {kwh:.2f} kWh from the battery, ")
    consumption = float(line.split(", ")[1].split()[0])
    assert consumption == pytest.approx(kwh / km * 100, rel=0.01)  # as anybody computes it
    miles = owner_line(town.drive, town.metrics, US)
    assert miles.startswith(f"{km / 1.609344:.1f} mi in 2 min: {kwh:.2f} kWh from the battery, ")
    per_kwh = float(miles.split(", ")[1].removesuffix(" mi/kWh."))
    assert per_kwh == pytest.approx(km / 1.609344 / kwh, rel=0.03)


def test_what_a_charger_gave_is_told_apart(town):
    """An hour at 7 kW after the drive, in the same log: the drive took what it took."""
    end = town.drive.duration
    time = end + np.arange(1.0, 3601.0)
    plugged = replace(
        town.drive,
        speed=np.vstack([town.drive.speed, np.column_stack([time, 0 * time])]),
        measured=np.vstack([town.drive.measured, np.column_stack([time, 0 * time - 7000.0])]),
    )
    before, after = (owner_line(drive, town.metrics) for drive in (town.drive, plugged))
    assert after.startswith(before)
    assert after.endswith("Charged while it stood: 7.00 kWh, not included above.")
    assert charged(town.drive) == 0.0


def test_all_of_a_drive_is_in_its_breakdown(town):
    """What waits for more is learned when it ends: 10 s and 75 m would be missing."""
    parts, total = town.metrics["breakdown"], counted(town.drive)
    assert parts["distance_m"] == pytest.approx(total.distance, abs=10.0)
    assert parts["duration_s"] == pytest.approx(town.drive.duration, abs=1.5)
    measured = total.energy / JOULES_PER_KWH
    assert parts["measured"]["kwh"] == pytest.approx(measured, rel=0.02)
    speed = town.drive.speed[-1, 1]
    kinetic = 0.5 * town.metrics["parameters"]["mass"]["value"] * speed**2 / JOULES_PER_KWH
    assert parts["speed"]["kwh"] == pytest.approx(kinetic, rel=0.3, abs=2e-3)


def test_a_breakdown_of_an_impossible_mass_is_no_answer(vehicle, readings):
    """A current ten times too small: a car of two hundred kilograms."""
    small = (
        replace(reading, current=reading.current / 10.0)
        if isinstance(reading, BatteryReading)
        else reading
        for reading in readings
    )
    metrics = replayed(vehicle, small).metrics
    assert metrics["parameters"]["mass"]["state"] == "invalid"
    assert metrics["breakdown"]["unknown"] == INVALID


def test_regeneration_of_a_battery_that_is_never_charged_is_not_learned(vehicle, readings, town):
    """Its brakes do all, or its sensor shows no charging: neither tells of mu."""
    one_way = (
        replace(reading, current=min(reading.current, 0.0))
        if isinstance(reading, BatteryReading)
        else reading
        for reading in readings
    )
    mu = replayed(vehicle, one_way).metrics["parameters"]["mu"]
    assert mu["state"] == "unestimated" and mu["prior_share"] == 1.0
    assert town.metrics["parameters"]["mu"]["prior_share"] < 0.8


def test_the_state_of_health_is_that_of_the_battery_or_the_reason_why_not(vehicle):
    aged = replace(vehicle, battery_capacity=0.7 * RATED)
    chain = chain_of(replace(vehicle, battery_capacity=RATED))
    readings = simulate(DriveKind.URBAN, aged, 240.0, seed=11).readings
    drive, gauge = replayed(vehicle, readings, chain).drive, chain.account.gauge
    health, sigma = gauge.health
    assert abs(health - 0.7) < 2.0 * sigma < 0.15
    line = health_line(gauge, [drive])
    assert (
        f"{100 * health:.0f} +- {100 * sigma:.0f} %" in line and "% of the 1.4 kWh of its" in line
    )
    reasons = {
        "the log has no state of charge": (ChargeGauge(RATED), replace(drive, charge=NOTHING)),
        "no drive or charge of 10 % was measured": (ChargeGauge(RATED), drive),
        "no battery_capacity to compare": (of_rated(gauge, float("nan")), drive),
        "more than the 0.7 kWh of its vehicle file": (of_rated(gauge, 0.5 * RATED), drive),
    }
    for reason, (known, seen) in reasons.items():
        line = health_line(known, [seen])
        assert line.startswith("State of health of the battery: not known yet: ")
        assert reason in line


def of_rated(gauge: ChargeGauge, capacity: float) -> ChargeGauge:
    """What a gauge has learned, of a car whose file says this capacity, J."""
    other = ChargeGauge(capacity)
    other.take(gauge.saved())
    return other


@pytest.mark.nightly
@pytest.mark.skipif(not DATA.is_dir(), reason="no shared data")
def test_the_state_of_health_of_an_e208_is_near_that_which_the_car_reports():
    """It reports 98 to 99 %, of a capacity that it does not tell."""
    log = DATA / "peugeot_e208_car_scanner" / "2023-12-16_08-53-55.csv.gz"
    health, sigma = ev.replay(log, vehicle="peugeot_e_208_50_kwh_2020").account.gauge.health
    assert abs(health - 0.99) < 2.0 * sigma < 0.12
