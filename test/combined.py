"""Battery power of all cars that no data can tell apart."""

from typing import Any

from evpinn_ros.core.vehicle.identifiable import Identifiable
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.core.vehicle.physics import RegenForm, battery_power


def combined_power(
    speed: Any,
    acceleration: Any,
    combined: Identifiable,
    *,
    air_density: Any,
    grade: Any = 0.0,
    rotating_mass_factor: float = 1.0,
) -> Any:
    """Battery power, W, of every car with these combinations (`physics.battery_power`).

    The inertia of rotating parts scales the acceleration; grade in rad, air density in kg/m^3.
    """
    car = Parameters(
        eta=1.0,
        mu=combined.regeneration,
        mass=combined.mass_over_eta,
        c_rr=combined.c_rr,
        c_d=combined.drag_area_over_eta,
        p_aux=combined.p_aux,
    )
    return battery_power(
        speed,
        rotating_mass_factor * acceleration,
        car,
        area=1.0,
        air_density=air_density,
        form=RegenForm.WHEEL_POWER,
        beta=0.0,
        grade=grade,
    )
