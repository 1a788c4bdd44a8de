"""Optional packages, and the extra of `setup.py` that brings each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from evpinn_ros.common.errors import InputError

EXTRA_OF = {
    "asammdf": "mf4",
    "distributed": "fleet",
    "jinja2": "report",
    "kuksa_client": "vss",
    "matplotlib": "report",
    "openpyxl": "tables",
    "paho": "mqtt",
    "pandas": "tables",
    "polars": "tables",
    "pyarrow": "fleet",
    "rasterio": "elevation",
    "rclpy": "ros",
}
"""Extra by name of the imported module: all extras of `setup.py` that a command needs."""


@contextmanager
def optional_imports() -> Iterator[None]:
    """Imports optional packages in a block; if one is missing, the error names its extra."""
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRA_OF:
            raise
        other = "source a ROS 2, or " if package == "rclpy" else ""
        line = f"{other}pip install 'evpinn_ros[{EXTRA_OF[package]}]'"
        raise InputError(f"{package} is not installed: {line}") from error


def pandas() -> Any:
    """The module pandas, imported when the first table is made: it takes 0.3 s and 60 MB.

    Raises:
        InputError: pandas is not installed.
    """
    with optional_imports():
        import pandas as pd
    return pd
