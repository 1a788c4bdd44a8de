"""FASTSim 3 (NREL; `fastsim` on PyPI), a simulator of whole vehicles, and the cycles it drives.

Optional, and no extra of this package: fastsim 3.1 wants msgpack 1.2.1 or newer, python-can's
multicast bus wants 1.1. It runs with 1.1 too: `pip install --no-deps fastsim pandas plotly polars
polars-runtime-32`.

It steps through a cycle and models what ours does not: limits of motor, battery and tyres, so that
a cycle may be missed; the motor's efficiency by load, the battery's, the gearbox's; state of
charge; cabin and battery temperatures with a heat pump. Ours has what was learned of one car.
"""

from __future__ import annotations

import csv
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from evpinn_ros.common.errors import InputError


def fastsim_version() -> str | None:
    """Version of the installed fastsim, None if there is none."""
    try:
        return version("fastsim")
    except PackageNotFoundError:
        return None


def fastsim_cycle(time_s: np.ndarray, speed: np.ndarray, slope: np.ndarray) -> Any:
    """A cycle of its own: speeds in m/s, and the slope of the road up to each."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "cycle.csv"
        rows = np.column_stack((time_s, speed, slope))
        names = "time_seconds,speed_meters_per_second,grade"
        np.savetxt(file, rows, delimiter=",", header=names, comments="")
        return import_module("fastsim").Cycle.from_file(str(file))


def read_cycle(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Time, s, and speed, m/s, of a drive cycle with the columns cycSecs and cycMps.

    Raises:
        InputError: no such file, or no such columns.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [(float(row["cycSecs"]), float(row["cycMps"])) for row in csv.DictReader(file)]
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except (KeyError, ValueError) as error:
        raise InputError(f"{path}: no drive cycle with columns cycSecs and cycMps") from error
    time_s, speed = np.array(rows).T
    return time_s, speed
