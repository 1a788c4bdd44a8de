"""Options on how to read a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from evpinn_ros.logs.terrain import Terrain
    from evpinn_ros.topics.readings import Rotation


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Options for what a recording does not tell itself; each kind takes those that concern it."""

    can_profile: str | None = None  # of a CAN log; None: that of the vehicle
    trust_profile: bool = False  # read a CAN log also where it contradicts the profile
    # of a table that are given, see `evpinn_ros.logs.column.columns_by_name`
    columns: Sequence[str] = ()
    # the one to read, where a table or a bag holds several: what the table's column of cars has,
    # or the namespace of its topics
    car: str | None = None
    # heights to take in place of those recorded, where the place is known
    terrain: Terrain | None = None
    # of the IMU in a bag, see `evpinn_ros.topics.readings.grade_reading`
    mounting: Rotation | None = None
    battery: bool = True  # False for a table that needs no columns of a battery


READ_DEFAULTS = ReadOptions()
