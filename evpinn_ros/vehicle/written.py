"""A vehicle with what was found as its priors, written as a vehicle file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
import math
from pathlib import Path
from typing import Any

import yaml

from evpinn_ros.common.writer import replaced
from evpinn_ros.vehicle.files import CONSTANTS, OPTIONAL_CONSTANTS, Vehicle, load_vehicle
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES, Prior


def write_vehicle(path: Path, vehicle: Vehicle) -> None:
    """Write a vehicle file, and read it back; the constants are of the file it came from.

    Raises:
        OSError: it cannot be written.
        InputError: it would not be a valid vehicle file.
    """
    document: dict[str, Any] = {"name": vehicle.name}
    if vehicle.can_profile is not None:
        document["can_profile"] = _profile(vehicle.can_profile)
    for name in CONSTANTS:
        value = getattr(vehicle, name)
        if math.isfinite(value) and value != OPTIONAL_CONSTANTS.get(name):
            document[name] = {"value": value, "source": f"vehicle {vehicle.key}"}
    document["parameters"] = _parameters(vehicle.priors)
    if vehicle.correlations:
        document["correlations"] = {"source": f"vehicle {vehicle.key}"}
        for (one, other), value in vehicle.correlations.items():
            document["correlations"].setdefault(one, {})[other] = value
    if vehicle.paper_start:
        document["paper_start"] = _parameters(vehicle.paper_start)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path) as draft:
        draft.write_text(yaml.safe_dump(document, sort_keys=False, width=99), encoding="utf-8")
    load_vehicle(path)


def _parameters(priors: Mapping[str, Prior]) -> dict[str, Any]:
    return {name: asdict(priors[name]) for name in PARAMETER_NAMES}


def _profile(name: str) -> str:
    """A profile's name; a path is relative to the vehicle file, so from another place absolute."""
    return str(Path(name).resolve()) if Path(name).suffix in (".yaml", ".yml") else name
