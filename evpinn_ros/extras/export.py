"""`evpinn export`: what was learned, in the files of other programs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from evpinn_ros.cli.console import say
from evpinn_ros.cli.lazy import ReadableCommand, ReadableGroup
from evpinn_ros.cli.options import VehicleOption
from evpinn_ros.common.errors import InputError

CHARGED_IN = 4.0  # hours, where no charging current is given
RADIUS = 0.3  # m

export = typer.Typer(cls=ReadableGroup, no_args_is_help=True)


@export.callback()
def group() -> None:
    """Export what was learned to other programs.

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
            min=0.1, max=1e4, help="Capacity of the battery, A h; else as learned, or by its file."
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

    Put the lines under `rmf_fleet` in the adapter's config.yaml. The formula of RMF has neither
    efficiency nor regeneration: the printed mass and friction are those with which it gives the
    energy that was learned.

    Example: evpinn export rmf robot.json --vehicle mobile_robot --capacity 25
    """
    # Here, for these import what takes longer than all else together.
    from evpinn_ros.api.estimator import Estimator
    from evpinn_ros.core.energy.charge import Uncertain
    from evpinn_ros.extras.rmf import rmf_energy

    car = Estimator(vehicle, state=state)
    gauge = car.account.gauge
    robot = rmf_energy(car.model, car.vehicle, gauge.capacity, speed)
    holds, source = robot.capacity, "as its drives showed" if gauge.learned else "its vehicle file"
    if capacity is not None:
        holds, source = Uncertain(capacity, math.nan), "given"
    if not math.isfinite(holds.value):
        raise InputError(
            f"the capacity of the battery of {vehicle} is not known: give --capacity, write "
            "battery_capacity into its vehicle file, or replay a drive that takes ten percent"
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
