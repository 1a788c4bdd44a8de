"""Smaller vehicles, robots above all: learned as the car that is similar to them."""

from dataclasses import replace

import numpy as np
import pytest

from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import Plan
from evpinn_ros.core.energy.power_model import PowerModel, Weather, vehicle_model
from evpinn_ros.core.estimation.estimate import ParameterSet, PowerEstimate
from evpinn_ros.core.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import AuxiliaryReading, BatteryReading
from evpinn_ros.core.vehicle.files import EXTENSIVE, Vehicle
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES

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
    outputs = estimator.add_readings(readings)
    return estimator, outputs


@pytest.mark.slow
def test_a_vehicle_of_a_part_of_a_car_s_size_is_learned_as_that_car(vehicle, drive):
    readings = list(drive(1, 120.0).readings)
    start = readings[0].stamp_ns
    readings.insert(1, AuxiliaryReading(start, 320.0))
    small = [
        replace(reading, current=SIZE * reading.current)
        if isinstance(reading, BatteryReading)
        else replace(reading, heating=SIZE * reading.heating)
        if isinstance(reading, AuxiliaryReading)
        else reading
        for reading in readings
    ]
    (car, big), (robot, little) = run(vehicle, readings), run(smaller(vehicle), small)
    assert len(big) == len(little) > 1000
    for full, scaled in zip(big, little, strict=True):
        if isinstance(full, PowerEstimate):
            assert SIZE * full.power == pytest.approx(scaled.power, rel=1e-9, abs=1e-9)
            assert SIZE * full.sigma == pytest.approx(scaled.sigma, rel=1e-9)
        else:
            assert isinstance(scaled, ParameterSet) and full.stamp_ns == scaled.stamp_ns
    ours, theirs = car.parameters(), robot.parameters()
    for name in PARAMETER_NAMES:
        scale = SIZE if name in EXTENSIVE else 1.0
        full, scaled = ours.parameters[name], theirs.parameters[name]
        assert scale * full.value == pytest.approx(scaled.value)
        assert scale * full.std == pytest.approx(scaled.std)
        assert full.trust == scaled.trust
    assert SIZE * ours.identifiable.mass_over_eta == pytest.approx(
        theirs.identifiable.mass_over_eta
    )
    parts, small_parts = car.breakdown(), robot.breakdown()
    assert small_parts.energy == pytest.approx(SIZE * parts.energy)
    assert small_parts.measured == pytest.approx(SIZE * parts.measured)
    by_car, by_robot = (
        forecast_plan(PLAN, PowerModel(estimator.model()), Weather(1.2), 60.0)
        for estimator in (car, robot)
    )
    assert by_robot.energy == pytest.approx(SIZE * by_car.energy, rel=1e-6)
    assert by_robot.sigma == pytest.approx(SIZE * by_car.sigma, rel=1e-6)


def test_a_plan_of_a_vehicle_never_driven_goes_with_its_size(vehicle):
    by_car, by_robot = (
        forecast_plan(PLAN, vehicle_model(driven), Weather(1.2), 60.0)
        for driven in (vehicle, smaller(vehicle))
    )
    assert by_robot.energy == pytest.approx(SIZE * by_car.energy)
    assert by_robot.sigma == pytest.approx(SIZE * by_car.sigma)
