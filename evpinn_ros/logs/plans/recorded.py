"""Plans in recordings: the newest of a planner, else the drive itself, without its battery."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
import math
from pathlib import Path

import numpy as np

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import decode
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.driven import PLAN_STEP, drive_plan
from evpinn_ros.core.energy.path_plan import NOMINAL_SPEED
from evpinn_ros.core.energy.plan import Plan, PlanError, sums, travelled
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    GradeReading,
    Reading,
    SpeedReading,
)
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.logs.plans.way import plausible_heights
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.sources import open_source
from evpinn_ros.topics import FRAME_TYPE, SPEEDS
from evpinn_ros.topics.plans import PLAN_TYPES, plan_of_message

FIELDS = {SpeedReading: "speed", AltitudeReading: "altitude", GradeReading: "grade"}
LEAST_GAP = 60.0  # s between two speeds
GAP_STEPS = 10.0  # mean steps, which a gap exceeds as well: some plans have few rows
LONG_GAP = 600.0  # s, after which the log is of another drive
STANDING = 0.5  # m/s before a gap and after it
SHORTEST = 2.0  # s
UNIT_OF_TIME = "a column of times says its unit, as t_s or 'time [ms]' do"
DRIVEN = {topic.type_name for topic in SPEEDS} | {FRAME_TYPE}


def driven_plan(path: Path, vehicle: Vehicle, options: ReadOptions) -> Plan:
    """A recorded drive of any kind as a plan; InputError if unreadable, PlanError if invalid."""
    source = open_source(path, vehicle, replace(options, battery=False))
    readings = [reading for reading in source.readings() if type(reading) in FIELDS]
    if source.problem:
        raise InputError(source.problem)
    mixed = not source.in_order and not source.dated  # how long legs take may stand there
    if mixed or source.dropped["time_not_increasing"] > len(readings):
        raise PlanError("its times do not rise, so they are no times")
    return plan_of_readings(readings)


def plan_of_readings(readings: Iterable[Reading]) -> Plan:
    """The plan of a drive's speeds and altitudes, or else grades, without a log's pauses."""
    rows: dict[type, list[tuple[int, float]]] = {kind: [] for kind in FIELDS}
    for reading in readings:
        if (kind := type(reading)) in FIELDS:
            rows[kind].append((reading.stamp_ns, getattr(reading, FIELDS[kind])))
    start = min((stamp for stamp, _ in rows[SpeedReading]), default=0)
    speed, altitude, grade = (_series(rows[kind], start) for kind in FIELDS)
    if len(speed) < 2 or speed[-1, 0] < SHORTEST:
        raise PlanError(f"a drive of less than {SHORTEST:g} s is no plan; {UNIT_OF_TIME}")
    time = _driven(speed)
    for series in (altitude, grade, speed):
        series[:, 0] = np.interp(series[:, 0], speed[:, 0], time)
    if len(altitude):
        along = np.interp(altitude[:, 0], time, travelled(time, speed[:, 1]))
        altitude[:, 1] = plausible_heights(along, altitude[:, 1])
    elif len(grade):
        slope = np.sin(np.interp(time, *grade.T))
        altitude = np.column_stack((time, travelled(time, speed[:, 1] * slope)))
    return drive_plan(speed, altitude)


def _series(rows: list[tuple[int, float]], start: int) -> np.ndarray:
    """Time, s, and value, each moment once and in order, shape (n, 2)."""
    value_at = dict(sorted(row for row in rows if np.isfinite(row[1])))
    seconds = [((stamp - start) / NANOSECONDS, value) for stamp, value in value_at.items()]
    return np.array(seconds, float).reshape(-1, 2)


def _driven(speed: np.ndarray) -> np.ndarray:
    """Times since the first speed, s, without gaps but short ones and short standstills."""
    steps = np.diff(speed[:, 0])
    gap = steps > max(LEAST_GAP, GAP_STEPS * float(np.minimum(steps, LONG_GAP).mean()))
    moving = np.maximum(np.abs(speed[:-1, 1]), np.abs(speed[1:, 1])) > STANDING
    left_out = gap & (moving | (steps > LONG_GAP))
    return sums(np.where(left_out, PLAN_STEP, steps))


def planned_in_bag(path: Path, vehicle: Vehicle) -> Plan | None:
    """The newest plan in a bag, as the node reads it; None if there is none, or a drive."""
    own = vehicle.nominal_speed
    usual = NOMINAL_SPEED if math.isnan(own) else own
    plan: Plan | PlanError | None = None
    with BagReader(path) as bag:
        if DRIVEN & {topic.type_name for topic in bag.topics.values()}:
            return None
        names = {name for name, topic in bag.topics.items() if topic.type_name in PLAN_TYPES}
        for record in bag.raw_records(names):
            try:
                plan = plan_of_message(record.type_name, record.message, decode, usual)
            except PlanError as error:
                plan = plan or PlanError(f"{record.topic}: {error}")
    if isinstance(plan, PlanError):
        raise plan
    return plan
