"""A drive over the distance driven, so that drives of one road lie on each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, Units
from evpinn_ros.replays.driven import measured_steps, rising
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.scoring import running_total


class Course(NamedTuple):
    """Values at even distances; shape (n,) each, NaN where unknown.

    Attributes:
        distance: km or miles.
        energy: measured since the start, kWh; none is counted while the battery is not measured,
            or is charged.
        speed: mean since the point before, of as many an hour.
        height: m or feet, where altitude was recorded.
    """

    distance: np.ndarray
    energy: np.ndarray
    speed: np.ndarray
    height: np.ndarray


def distance_until(drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    """Time, s, and distance until then, m, of each speed, none across gaps; shape (n,) each."""
    time, speed = rising(drive.speed).T
    return time, running_total(time, np.abs(speed))


def over_distance(drive: Drive, points: int, units: Units = METRIC) -> Course:
    """The course of a drive at `points` even distances."""
    time, metres = distance_until(drive)
    at = np.linspace(0.0, metres[-1], points)
    moments = np.interp(at, metres, time)
    speed = np.full(points, np.nan)
    speed[1:] = np.diff(at) / np.maximum(np.diff(moments), 1e-3) * units.speeds
    steps = measured_steps(drive)
    energy = _at(moments, steps.end, np.cumsum(steps.energy), left=0.0) / JOULES_PER_KWH
    height = _at(moments, *drive.altitude.T, left=np.nan, right=np.nan) / units.height_metres
    return Course(at / units.metres, energy, speed, height)


def _at(moments: np.ndarray, time: np.ndarray, values: np.ndarray, **ends: float) -> np.ndarray:
    if not len(time):
        return np.full(len(moments), np.nan)
    order = np.argsort(time, kind="stable")
    return np.asarray(np.interp(moments, time[order], values[order], **ends))
