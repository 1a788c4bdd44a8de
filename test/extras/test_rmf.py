"""Open-RMF's energy of motion, with the parameters made for it, is that of our forecasts."""

import math

import numpy as np
import pytest

from evpinn_ros.core.energy.charge import UNKNOWN, Uncertain
from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import Plan
from evpinn_ros.core.energy.power_model import Weather, vehicle_model
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.extras.export import rmf_energy

ROBOT = load_vehicle("mobile_robot")


def by_rmf(robot, time, speed):
    """Energy of motion and ambient power as rmf_battery adds them up, J: half a second a step."""
    steps = np.arange(0.0, time[-1], 0.5)
    v = np.interp(steps, time, speed)
    a = np.abs(np.interp(steps + 0.25, time, speed) - np.interp(steps - 0.25, time, speed)) / 0.5
    motion = robot.mass * a * v + robot.friction * robot.mass * 9.81 * v
    return 0.5 * motion.sum() + robot.ambient * time[-1]


@pytest.mark.parametrize("stops", [1, 5])
@pytest.mark.parametrize("car", ["mobile_robot", "tesla_model_3_lr"])
def test_a_trip_costs_in_rmf_what_it_costs_here(car, stops):
    vehicle = load_vehicle(car)
    model = vehicle_model(vehicle)
    robot = rmf_energy(model, vehicle, Uncertain(2e6, 1e5))
    speeds = np.interp(np.arange(0.0, 44.0), [0.0, 2.0, 40.0, 42.0], [0.0, 1.0, 1.0, 0.0])
    speed = robot.speed * np.tile(speeds, stops)
    time = np.arange(len(speed)) * 1.0
    distance = np.concatenate(([0.0], np.cumsum((speed[1:] + speed[:-1]) / 2.0)))
    plan = Plan(time, distance, speed, 0.0 * speed)
    weather = Weather(vehicle.air_density, heating=0.0)
    ours = forecast_plan(plan, model, weather, steady=True).energy[-1]
    assert by_rmf(robot, time, speed) == pytest.approx(ours, rel=0.03)


def test_a_capacity_is_in_ampere_hours():
    model = vehicle_model(ROBOT)
    robot = rmf_energy(model, ROBOT, Uncertain(25.6 * 3600.0 * 20.0, 25.6 * 3600.0))
    assert robot.capacity == pytest.approx((20.0, 1.0)) and robot.voltage == 25.6
    assert math.isnan(rmf_energy(model, ROBOT, UNKNOWN).capacity.value)
    assert rmf_energy(model, ROBOT, UNKNOWN).speed == 1.0 == ROBOT.nominal_speed
    assert rmf_energy(model, ROBOT, UNKNOWN, 0.5).speed == 0.5
