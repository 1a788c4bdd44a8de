"""A car that obeys eq. 21 to the letter: what a method must find if it can find anything.

One constant efficiency each way, no loss map, no wind, no hills, a constant auxiliary load. The
sensors are those of every simulated car. No real car is like it; `simulate` without a form is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evpinn_ros.simulation.car import STEP, Car, Trace, draw_car
from evpinn_ros.simulation.drive import IntervalMotion
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.parameters import Parameters
from evpinn_ros.vehicle.physics import (
    RegenForm,
    battery_power,
    drag_force,
    inertia_force,
    rolling_force,
)


def equation_car(vehicle: Vehicle, parameters: Parameters, rng: np.random.Generator) -> Car:
    """A car of these parameters with the air and no more inertia than eq. 12-15 know."""
    car = draw_car(vehicle, parameters, rng)
    return replace(car, air_density=vehicle.air_density, rotating_mass_factor=1.0)


def drive_equation_car(
    car: Car, parameters: Parameters, motion: IntervalMotion, form: RegenForm, beta: float
) -> Trace:
    """Everything that happens while the car moves like this on a flat road."""
    speed, nothing = motion.speed, np.zeros_like(motion.speed)
    drag = drag_force(speed, car.frontal_area * car.c_d, car.air_density) * speed
    rolling = rolling_force(car.mass, car.c_rr) * speed
    power = battery_power(
        speed,
        motion.acceleration,
        parameters,
        area=car.frontal_area,
        air_density=car.air_density,
        form=form,
        beta=beta,
    )
    wheel = drag + rolling + inertia_force(car.mass, motion.acceleration) * speed
    battery = car.battery.deliver(power, STEP)
    return Trace(
        motion=motion,
        head_wind=nothing,
        wheel_power=wheel,
        drag_power=drag,
        rolling_power=rolling,
        friction_power=nothing,
        no_load_loss=nothing,
        load_loss=power - wheel - parameters.p_aux,
        auxiliary=np.full_like(speed, parameters.p_aux),
        power=power,
        **battery._asdict(),
    )
