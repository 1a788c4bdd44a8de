"""Logs that a benchmark runs over, and the car of each.

`PATH`, `PATH=VEHICLE` or `PATH=VEHICLE,PROFILE`: so one run covers several cars. A folder that is
no bag is searched for bags, CAN logs and CSV drives, however deep.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.formats import recordings


class Log(NamedTuple):
    """A log, the vehicle it is of, and the CAN profile if it is not the vehicle's own."""

    path: Path
    vehicle: str
    can_profile: str | None


def find_logs(argument: str, vehicle: str) -> list[Log]:
    """The logs that an argument names, in order of their paths.

    They are of `vehicle` where the argument does not say.

    Raises:
        InputError: nothing is there.
    """
    path, profile = Path(argument), None
    if not path.exists() and "=" in argument:
        before, _, car = argument.rpartition("=")
        path = Path(before)
        vehicle, _, profile = car.partition(",")
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    found = [Log(each, vehicle, profile or None) for each in sorted(recordings(path))]
    if not found:
        raise InputError(f"{path}: holds no bag, CAN log or CSV")
    return found
