"""Robots: learned as the car that is similar to them, and what ten minutes of one teach."""

from dataclasses import replace
import math

import numpy as np
import pytest

import evpinn_ros as ev
from evpinn_ros.energy.forecast import forecast_plan
from evpinn_ros.energy.path_plan import plan_from_path
from evpinn_ros.energy.plan import Plan
from evpinn_ros.energy.power_model import PowerModel, Weather, vehicle_model
from evpinn_ros.estimation.estimate import ParameterSet, PowerEstimate
from evpinn_ros.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.estimation.worker import InlineWorker
from evpinn_ros.signals.readings import AuxiliaryReading, BatteryReading
from evpinn_ros.vehicle.files import EXTENSIVE, Vehicle, load_vehicle
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES
from test.robots import learned, moments, robot, true_energy

SIZE = 1 / 32  # whose products with floats are exact
PLAN = Plan(
    np.array([0.0, 10.0, 100.0, 110.0]),
    np.array([0.0, 50.0, 950.0, 1000.0]),
    np.array([0.0, 10.0, 10.0, 0.0]),
    np.zeros(4),
)


def smaller(vehicle: Vehicle) -> Vehicle:
    """A vehicle whose similar car is this one."""
    priors = dict(vehicle.priors)
    for name in ("mass", "p_aux"):
        prior = priors[name]
        priors[name] = replace(prior, value=SIZE * prior.value, std=SIZE * prior.std)
    return replace(
        vehicle,
        relative_size=SIZE,
        frontal_area=SIZE * vehicle.frontal_area,
        priors=priors,
        paper_start={},
    )


def run(vehicle, readings):
    """An estimator after some readings, with the powers it gave."""
    estimator = OnlineEstimator(vehicle, EstimatorSettings(), InlineWorker(lambda: 0.0))
    found = [each for reading in readings for each in estimator.add_reading(reading)]
    return estimator, found


@pytest.mark.slow
def test_a_vehicle_of_a_part_of_a_car_s_size_is_learned_as_that_car(vehicle, drive):
    readings = list(drive(1, 120.0).readings)
    start = readings[0].stamp_ns
    readings.insert(1, AuxiliaryReading(start, 320.0))
    small = [
        replace(each, current=SIZE * each.current)
        if isinstance(each, BatteryReading)
        else replace(each, heating=SIZE * each.heating)
        if isinstance(each, AuxiliaryReading)
        else each
        for each in readings
    ]
    (car, big), (robot, little) = run(vehicle, readings), run(smaller(vehicle), small)
    assert len(big) == len(little) > 1000
    for one, other in zip(big, little, strict=True):
        if isinstance(one, PowerEstimate):
            assert SIZE * one.power == pytest.approx(other.power, rel=1e-9, abs=1e-9)
            assert SIZE * one.sigma == pytest.approx(other.sigma, rel=1e-9)
        else:
            assert isinstance(other, ParameterSet) and one.stamp_ns == other.stamp_ns
    ours, theirs = car.parameters(), robot.parameters()
    for name in PARAMETER_NAMES:
        scale = SIZE if name in EXTENSIVE else 1.0
        one, other = ours.parameters[name], theirs.parameters[name]
        assert scale * one.value == pytest.approx(other.value)
        assert scale * one.std == pytest.approx(other.std)
        assert one.trust == other.trust
    assert SIZE * ours.identifiable.mass_over_eta == pytest.approx(
        theirs.identifiable.mass_over_eta
    )
    parts, small_parts = car.breakdown(), robot.breakdown()
    assert small_parts.energy == pytest.approx(SIZE * parts.energy)
    assert small_parts.measured == pytest.approx(SIZE * parts.measured)
    by_car, by_robot = (
        forecast_plan(PLAN, PowerModel(each.model()), Weather(1.2), 60.0) for each in (car, robot)
    )
    assert by_robot.energy == pytest.approx(SIZE * by_car.energy, rel=1e-6)
    assert by_robot.sigma == pytest.approx(SIZE * by_car.sigma, rel=1e-6)


def test_a_plan_of_a_vehicle_never_driven_goes_with_its_size(vehicle):
    by_car, by_robot = (
        forecast_plan(PLAN, vehicle_model(each), Weather(1.2), 60.0)
        for each in (vehicle, smaller(vehicle))
    )
    assert by_robot.energy == pytest.approx(SIZE * by_car.energy)
    assert by_robot.sigma == pytest.approx(SIZE * by_car.sigma)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_a_robot_teaches_in_ten_minutes(seed):
    """Energy of a path within 3 sigma and a fifth; the file alone is off by as much as it says."""
    never, known = (vehicle_model(load_vehicle("mobile_robot")), learned(seed).model)
    for metres in (20.0, 100.0, 300.0):
        line = np.array([0.0, metres / 2, metres])
        plan = plan_from_path(line, 0.0 * line, 0.0 * line, nominal_speed=1.0)
        truth = true_energy(plan)
        before, after = (forecast_plan(plan, each, Weather(1.2), 0.0) for each in (never, known))
        assert abs(after.energy[-1] - truth) < min(3.0 * after.sigma[-1], 0.2 * truth)
        assert after.sigma[-1] < 0.25 * truth < 0.5 * before.sigma[-1]
        assert abs(before.energy[-1] - truth) < 2.0 * before.sigma[-1]
    parameters = learned(seed).parameters
    load = np.mean([now.true_load for now in moments(seed, 600.0)])
    assert parameters.value["p_aux"] == pytest.approx(load, rel=0.15)
    assert parameters.state["p_aux"] == "valid"
    assert set(parameters.state) <= {"valid", "estimating", "unestimated"}


@pytest.mark.nightly
def test_a_robot_s_battery_may_drop_out_for_ten_minutes():
    truth, energies = 0.0, {}
    estimator = ev.Estimator("mobile_robot")
    for now in moments(1, 1200.0):
        measured = now.battery_due and now.time < 600.0
        battery = (now.voltage, now.current) if measured else (math.nan, math.nan)
        found = estimator.add(now.time, now.speed, *battery)
        truth += now.true_power * robot().STEP if now.time >= 600.0 else 0.0
        energies[now.time >= 600.0] = found.energy_j, found.energy_sigma_j
    taken, sigma = energies[True][0] - energies[False][0], energies[True][1]
    assert abs(taken - truth) < 2.0 * sigma < 0.3 * truth
