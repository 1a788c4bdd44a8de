"""A recorded drive as a plan: its speed and its height; its battery is ignored."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.sources import open_source
from evpinn_ros.energy.driven import drive_plan, travelled
from evpinn_ros.energy.plan import Plan, PlanError
from evpinn_ros.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    GradeReading,
    Reading,
    SpeedReading,
)
from evpinn_ros.vehicle.files import Vehicle

FIELDS = {SpeedReading: "speed", AltitudeReading: "altitude", GradeReading: "grade"}
LEAST_GAP = 60.0  # s between two speeds; what the car did meanwhile is not known
GAP_STEPS = 10.0  # mean steps that a gap is longer than
STANDING = 0.5  # m/s: it stood before the gap and after it
SHORTEST = 2.0  # s


def driven_plan(path: Path, vehicle: Vehicle) -> Plan:
    """The plan that a recorded drive would have been, of any kind that `evpinn replay` reads.

    Raises:
        InputError: it cannot be read; `PlanError`: it is no trip.
    """
    source = open_source(path, vehicle, battery=False)
    plan = plan_of_readings(source.readings())
    if source.problem:
        raise InputError(source.problem)
    return plan


def plan_of_readings(readings: Iterable[Reading]) -> Plan:
    """The plan of a drive's speeds, and of its altitudes or, where there is none, its grades.

    Raises:
        PlanError: too short, or the speed is unknown for a while.
    """
    rows: dict[type, list[tuple[int, float]]] = {kind: [] for kind in FIELDS}
    for reading in readings:
        if (kind := type(reading)) in FIELDS:
            rows[kind].append((reading.stamp_ns, getattr(reading, FIELDS[kind])))
    start = min((stamp for stamp, _ in rows[SpeedReading]), default=0)
    speed, altitude, grade = (_series(rows[kind], start) for kind in FIELDS)
    if len(speed) < 2 or speed[-1, 0] < SHORTEST:
        raise PlanError(f"a drive of less than {SHORTEST:g} s is no plan")
    _refuse_gaps(speed)
    if not len(altitude) and len(grade):
        altitude = np.column_stack((speed[:, 0], _height(speed, grade)))
    return drive_plan(speed, altitude)


def _series(rows: list[tuple[int, float]], start: int) -> np.ndarray:
    """Time, s, and value, each moment once and in order, shape (n, 2)."""
    found = dict(sorted(row for row in rows if np.isfinite(row[1])))
    seconds = [((stamp - start) / NANOSECONDS, value) for stamp, value in found.items()]
    return np.array(seconds, float).reshape(-1, 2)


def _refuse_gaps(speed: np.ndarray) -> None:
    steps = np.diff(speed[:, 0])
    gaps = steps > max(LEAST_GAP, GAP_STEPS * float(steps.mean()))
    moving = np.maximum(np.abs(speed[:-1, 1]), np.abs(speed[1:, 1])) > STANDING
    if (gaps & moving).any():
        where = int((gaps & moving).argmax())
        raise PlanError(
            f"its speed is unknown for {steps[where]:.0f} s from {speed[where, 0]:.0f} s on, "
            "while the car moved"
        )


def _height(speed: np.ndarray, grade: np.ndarray) -> np.ndarray:
    """Height, m, at the times of the speeds, shape (n,), as the slopes, rad, make it."""
    slope = np.sin(np.interp(speed[:, 0], *grade.T))
    return travelled(speed[:, 0], speed[:, 1] * slope)
