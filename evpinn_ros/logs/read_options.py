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
    columns: Sequence[str] = ()  # choices of a table, see `logs.column.columns_by_name`
    # the one to read, where a table or a bag holds several: what the table's column of cars has,
    # or the namespace of its topics
    car: str | None = None
    terrain: Terrain | None = None  # heights in place of recorded ones, where positions are known
    mounting: Rotation | None = None  # of a bag's IMU, see `topics.readings.grade_reading`
    pace: float | None = None  # m/s, of a track that has neither times nor speeds
    battery: bool = True  # False for a table that needs no columns of a battery


READ_DEFAULTS = ReadOptions()
