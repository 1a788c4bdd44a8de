"""`evpinn check-params`: validates a configuration file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from evpinn_ros.can.profile import load_profile
from evpinn_ros.cli.console import say
from evpinn_ros.common.yaml_section import compose
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.topics.parameter_file import check_parameter_file

PROFILE_KEYS = ("dbc", "requests", "speed", "battery")


def check_params(
    file: Annotated[
        Path, typer.Argument(help="Parameter file of the nodes, vehicle file or CAN profile.")
    ],
) -> None:
    """Check a parameter file, a vehicle file or a CAN profile.

    Example: evpinn check-params my_car.yaml
    """
    root = compose(file, "file")
    if root.has("parameters"):
        kind = "vehicle file"
        vehicle = load_vehicle(file)
        if vehicle.can_profile is not None:
            load_profile(vehicle.can_profile)
    elif any(map(root.has, PROFILE_KEYS)):
        kind = "CAN profile"
        load_profile(file)
    else:
        kind = "parameter file"
        check_parameter_file(file)
    say(f"{file}: a valid {kind}")
