"""Reads the true parameters beside a simulated drive."""

from __future__ import annotations

from pathlib import Path

from evpinn_ros.common.yaml_section import compose
from evpinn_ros.core.vehicle.parameters import LIMITS, PARAMETER_NAMES, Parameters

TRUTH_FILE = "truth.yaml"


def read_truth(path: Path) -> Parameters | None:
    """True parameters beside a simulated drive's bag, None for a real one; InputError if wrong."""
    file = path / TRUTH_FILE
    if not file.is_file():
        return None
    section = compose(file, "truth").section("parameters")
    return Parameters(*(section.number(name, *LIMITS[name]) for name in PARAMETER_NAMES))
