"""`evpinn export`: the learned vehicle as parameters of Open-RMF (rmf_battery).

RMF computes power as mass |a| v + friction mass 9.81 v plus a constant, without efficiency. The
exported values give this vehicle's energy for a trip from rest to rest at its usual speed.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from evpinn_ros.cli.console import say
from evpinn_ros.cli.lazy import ReadableCommand, ReadableGroup
from evpinn_ros.cli.options import VehicleOption
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.path_plan import NOMINAL_SPEED
from evpinn_ros.core.energy.plan import Plan, plan_from_speed_profile
from evpinn_ros.core.energy.power_model import PowerModel, Weather
from evpinn_ros.core.vehicle.files import Vehicle

RMF_GRAVITY = 9.81  # m/s^2, that of rmf_battery
RAMP = 2.0  # s to reach the speed; energies hardly depend on it
CRUISES = 50.0, 100.0  # s at that speed, in the two compared trips
STANDING = 100.0  # s
SECONDS_PER_HOUR = 3600.0


@dataclass(frozen=True, slots=True)
class RmfEnergy:
    """Energy parameters for a fleet adapter of RMF."""

    voltage: float  # of the battery, V
    capacity: Uncertain  # A h at this voltage, and 1-sigma; NaN if unknown
    mass: float  # kg, in RMF's formula; not the weight
    friction: float  # coefficient
    ambient: float  # constant power, moving or not, W
    speed: float  # m/s at which these values hold
    trip: Uncertain  # energy of the longer compared trip, J, and its 1-sigma
    trip_metres: float  # length of that trip, m


def rmf_energy(
    model: PowerModel, vehicle: Vehicle, capacity: Uncertain, speed: float | None = None
) -> RmfEnergy:
    """Parameters with which RMF computes the forecast energy.

    `capacity`: J. `speed`: m/s, by default `nominal_speed` of the vehicle file.

    Raises:
        InputError: the model gives no positive energy for driving.
    """
    if speed is None:
        speed = NOMINAL_SPEED if math.isnan(vehicle.nominal_speed) else vehicle.nominal_speed
    weather = Weather(vehicle.air_density, heating=0.0)
    time = np.arange(0.0, STANDING + 1.0)
    rest = plan_from_speed_profile(time, None, 0.0 * time)
    short, long = (_trip(cruise, speed) for cruise in CRUISES)
    standing, less, more = (_energy(plan, model, weather) for plan in (rest, short, long))
    ambient = max(standing.value / STANDING, 0.0)
    duration, length = long.time[-1] - short.time[-1], long.distance[-1] - short.distance[-1]
    force = (more.value - less.value - ambient * duration) / length
    mass = (more.value - ambient * long.time[-1] - force * long.distance[-1]) / speed**2
    if not (mass > 0.0 and force > 0.0):
        raise InputError(
            f"what was learned of {vehicle.key} gives no energy for driving; replay more drives"
        )
    charge = vehicle.nominal_voltage * SECONDS_PER_HOUR
    return RmfEnergy(
        voltage=vehicle.nominal_voltage,
        capacity=Uncertain(capacity.value / charge, capacity.sigma / charge),
        mass=mass,
        friction=force / (mass * RMF_GRAVITY),
        ambient=ambient,
        speed=speed,
        trip=more,
        trip_metres=float(long.distance[-1]),
    )


def _trip(cruise: float, speed: float) -> Plan:
    """Plan from rest to rest with `cruise` s at `speed`, m/s; points at most 1 s apart."""
    ends = np.array([0.0, RAMP, RAMP + cruise, 2.0 * RAMP + cruise])
    time = np.unique(np.concatenate((np.arange(0.0, ends[-1], 1.0), ends)))
    return plan_from_speed_profile(time, None, np.interp(time, ends, [0.0, speed, speed, 0.0]))


def _energy(plan: Plan, model: PowerModel, weather: Weather) -> Uncertain:
    energies = forecast_plan(plan, model, weather, steady=True)
    return Uncertain(float(energies.energy[-1]), float(energies.sigma[-1]))


CHARGED_IN = 4.0  # hours, if no charging current is given
RADIUS = 0.3  # m

export = typer.Typer(cls=ReadableGroup, no_args_is_help=True)


@export.callback()
def group() -> None:
    """Export the learned energy model to the configuration of other programs.

    Example: evpinn export rmf robot.json --vehicle mobile_robot
    """


@export.command(cls=ReadableCommand)
def rmf(
    state: Annotated[Path, typer.Argument(help="File that evpinn replay or run --state wrote.")],
    vehicle: VehicleOption = "mobile_robot",
    speed: Annotated[
        float | None,
        typer.Option(
            min=0.05, max=50.0, help="Usual speed, m/s; that of the vehicle file if not given."
        ),
    ] = None,
    capacity: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            max=1e4,
            help="Capacity of the battery, A h; if not given, as learned, or of the vehicle file.",
        ),
    ] = None,
    charging_current: Annotated[
        float | None,
        typer.Option(
            min=0.01, max=1e4, help="Charging current, A; full within 4 hours if not given."
        ),
    ] = None,
    radius: Annotated[
        float, typer.Option(min=0.01, max=10.0, help="Radius of the robot, m.")
    ] = RADIUS,
    tool: Annotated[
        float, typer.Option(min=0.0, max=1e5, help="Power of the tool while it works, W.")
    ] = 0.0,
) -> None:
    """Print battery, mass and loads for the fleet adapter of Open-RMF.

    Put the lines under `rmf_fleet` in the adapter's config.yaml. RMF's formula has neither
    efficiency nor regeneration: the printed mass and friction make it give the learned energy.

    Example: evpinn export rmf robot.json --vehicle mobile_robot --capacity 25
    """
    # Imported here, because it takes longer than everything else.
    from evpinn_ros.api.estimator import Estimator

    car = Estimator(vehicle, state=state)
    gauge = car.account.gauge
    robot = rmf_energy(car.model, car.vehicle, gauge.capacity, speed)
    holds, source = robot.capacity, "as its drives showed" if gauge.learned else "its vehicle file"
    if capacity is not None:
        holds, source = Uncertain(capacity, math.nan), "given"
    if not math.isfinite(holds.value):
        raise InputError(
            f"the capacity of the battery of {vehicle} is not known: give --capacity, write "
            "battery_capacity into its vehicle file, or replay a drive that uses 10 % of charge"
        )
    current = holds.value / CHARGED_IN if charging_current is None else charging_current
    inertia = robot.mass * radius**2 / 2.0
    trip = f"{robot.trip_metres:.0f} m at {robot.speed:g} m/s take {robot.trip.value:.0f}"
    spread = f" +- {holds.sigma:.2g}" if math.isfinite(holds.sigma) else ""
    text = f"""\
# {vehicle}, as learned in {state}: {trip} +- {robot.trip.sigma:.0f} J.
rmf_fleet:
  battery_system:
    voltage: {robot.voltage:.1f}  # V, nominal, by the vehicle file
    capacity: {holds.value:.2f}  # A h{spread}, {source}
    charging_current: {current:.2f}  # A, {"given" if charging_current else "not learned"}
  mechanical_system:
    mass: {robot.mass:.3f}  # kg, for RMF's formula, not the weight
    moment_of_inertia: {inertia:.4f}  # kg m^2, not learned: a disc of radius {radius:g} m
    friction_coefficient: {robot.friction:.5f}  # at {robot.speed:g} m/s
  ambient_system:
    power: {robot.ambient:.2f}  # W, learned
  tool_system:
    power: {tool:.2f}  # W, {"given" if tool else "not learned"}"""
    for line in text.splitlines():
        say(line)
