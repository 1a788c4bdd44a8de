"""The plan of a planner in a bag that holds no drive: the newest one."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import math
from pathlib import Path

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import FRAME_TYPE
from evpinn_ros.energy.path_plan import NOMINAL_SPEED
from evpinn_ros.energy.plan import Plan, PlanError
from evpinn_ros.topics import AUTOWARE_TRAJECTORY_TYPE, PATH_TYPE, SPEEDS, TRAJECTORY_TYPE
from evpinn_ros.topics.cdr import CdrError
from evpinn_ros.topics.plans import path_plan, speed_profile_plan, trajectory_plan
from evpinn_ros.vehicle.files import Vehicle

DRIVEN = {topic.type_name for topic in SPEEDS} | {FRAME_TYPE}


def planned_in_bag(path: Path, vehicle: Vehicle) -> Plan | None:
    """The newest plan in a bag, as the node reads it from a topic.

    None where it holds none, or a speed or frames of a CAN bus, which are a drive.

    Args:
        path: of the bag.
        vehicle: whose nominal speed a path without times is driven at.

    Raises:
        InputError: it is no bag; `PlanError`: the newest cannot be driven.
    """
    own = vehicle.nominal_speed
    usual = NOMINAL_SPEED if math.isnan(own) else own
    readers: dict[str, Callable[[bytes], Plan]] = {
        PATH_TYPE: partial(path_plan, nominal_speed=usual),
        TRAJECTORY_TYPE: speed_profile_plan,
        AUTOWARE_TRAJECTORY_TYPE: trajectory_plan,
    }
    found: Plan | PlanError | None = None
    with BagReader(path) as bag:
        if DRIVEN & {each.type_name for each in bag.topics.values()}:
            return None
        names = {name for name, each in bag.topics.items() if each.type_name in readers}
        for record in bag.raw_records(names):
            try:
                found = readers[record.type_name](record.message)
            except (CdrError, PlanError) as error:
                found = found or PlanError(f"{record.topic}: {error}")
    if isinstance(found, PlanError):
        raise found
    return found
