"""Plan of a recorded drive, and smooth heights of its road."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evpinn_ros.core.energy.plan import (
    Plan,
    beside_line,
    plan_from_speed_profile,
    telling,
    travelled,
)

PLAN_STEP = 1.0  # s between points of a plan
COARSE = 5.0  # s between speeds, above which speed varies between them
ON_A_LINE = 1e-3  # m/s and m, finer than the rounding of receivers and logs
ELEVATION_STEP = 5.0  # m
ELEVATION_SMOOTHING = 50.0  # m, 1-sigma: a logged altitude comes in steps of a metre
MOST_STEPS = 1_000_000  # of elevation; longer drives have longer steps


def drive_plan(speed: np.ndarray, altitude: np.ndarray) -> Plan:
    """The plan of a recorded drive: speed once a second, and elevation.

    Speeds are commanded, unless they are more than `COARSE` apart: then each is a point of the
    plan, and uneven speed between them is expected.

    Args:
        speed: time, s, rising, and speed, m/s, shape (n, 2), some seconds long.
        altitude: time, s, and altitude, m, shape (m, 2); empty or constant if unknown.
    """
    time, speeds = speed[:, 0] - speed[0, 0], speed[:, 1]
    rough = float(np.median(np.diff(time))) > COARSE
    # The last step is up to half a step longer or shorter, so that the plan ends with the drive.
    steps = np.arange(0.0, time[-1] - PLAN_STEP / 2, PLAN_STEP)
    grid = time if rough else np.append(steps, time[-1])
    at = np.maximum(np.interp(grid, time, speeds), 0.0)
    height = None
    if len(altitude) and np.ptp(altitude[:, 1]):
        seen = np.interp(altitude[:, 0] - speed[0, 0], time, travelled(time, speeds))
        height = road_height(seen, altitude[:, 1], travelled(grid, at))
    return replace(plan_from_speed_profile(grid, None, at, height), commanded=not rough)


def is_trace(time: np.ndarray, column: np.ndarray) -> bool:
    """True if the rows of a plan are at most `COARSE` apart, without rows on a line.

    Args:
        time: s, rising, shape (n,).
        column: speeds, m/s, or distances, m, shape (n,).
    """
    corners = telling(len(time), beside_line(time, column, ON_A_LINE))
    return float(np.median(np.diff(time[corners]))) <= COARSE


def road_height(along: np.ndarray, height: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Heights of a road, m, at distances, m, shape (n,), smoothed over `ELEVATION_SMOOTHING`.

    Args:
        along: where heights are known, m, not falling, shape (m,).
        height: m, shape (m,).
        distance: from 0 on, not falling, shape (n,).
    """
    from scipy.ndimage import gaussian_filter1d  # here: 30 MB that only heights need

    end = max(float(along[-1]), float(distance[-1]))
    step = max(ELEVATION_STEP, end / MOST_STEPS)
    road = np.arange(0.0, end + step, step)
    first = np.concatenate(([True], np.diff(along) > 0))
    smooth = gaussian_filter1d(
        np.interp(road, along[first], height[first]), ELEVATION_SMOOTHING / step
    )
    heights: np.ndarray = np.interp(distance, road, smooth)
    return heights
