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
    """Options for reading a recording; each kind of recording uses some of them."""

    can_profile: str | None = None  # of a CAN log; None: the vehicle's
    trust_profile: bool = False  # True: read a CAN log even if it contradicts the profile
    columns: Sequence[str] = ()  # choices of a table, see `logs.column.columns_by_name`
    # car to read if a table or bag contains several: its value in the table's column of cars,
    # or its namespace in a bag
    car: str | None = None
    terrain: Terrain | None = None  # heights that replace recorded ones where positions are known
    mounting: Rotation | None = None  # of a bag's IMU, see `topics.readings.grade_reading`
    pace: float | None = None  # m/s, for a track without times and speeds
    battery: bool = True  # False for a table that needs no battery columns


READ_DEFAULTS = ReadOptions()
