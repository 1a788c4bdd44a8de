"""Noise of an interval: what no state explains of the energy of battery and motor."""

from __future__ import annotations

import math

import numpy as np

from evpinn_ros.estimation.weak_form import Spent
from evpinn_ros.signals.interval import Interval

STANDING_NOISE = 150.0  # W over `NOISE_TIME`
FORCE_NOISE = 40.0  # N over `NOISE_TIME`, the same while moving
NOISE_TIME = 1.5  # s within which that forgets itself
SHARE_NOISE = 0.03  # of the throughput: efficiency is a map, not a number
BRAKE_NOISE = 0.2  # of the braking energy: only a motor's torque shows the share of friction
MOTOR_NOISE = 0.05  # of the motor's energy, 1-sigma of torque times speed against the wheels


def battery_variance(interval: Interval, found: Spent, scale: np.ndarray) -> np.ndarray:
    """Variance of the battery's energy, J^2, shape (K,).

    Args:
        interval: of which it is.
        found: what it is expected to take.
        scale: of all noise but that of sampling, shape (K,).
    """
    base = (STANDING_NOISE * interval.duration) ** 2 + (FORCE_NOISE * interval.distance) ** 2
    own = scale * (base * NOISE_TIME / interval.duration + lost_variance(interval, found))
    sampling = 0.0 if math.isnan(interval.sampling_variance) else interval.sampling_variance
    return np.asarray(own + sampling)


def lost_variance(interval: Interval, found: Spent) -> np.ndarray:
    """Variance of what drivetrain and brakes lose beyond what the states say, J^2, shape (K,)."""
    friction = 0.0 if interval.steps.motor_known else BRAKE_NOISE
    share = (SHARE_NOISE * found.throughput) ** 2 + (friction * found.wheel_brake) ** 2
    return np.asarray(share)


def motor_variance(
    interval: Interval, most: np.ndarray, scale: np.ndarray, *, braking: bool
) -> np.ndarray:
    """Variance of the motor's energy against that of the wheels, J^2, shape (K,).

    Args:
        interval: of which it is.
        most: the larger of its measured and expected energy, J, shape (K,).
        scale: of the noise of forces, shape (K,).
        braking: whether the motor brakes: friction takes a share that it does not show.
    """
    base = (FORCE_NOISE * interval.distance) ** 2 * NOISE_TIME / interval.duration
    share = math.hypot(MOTOR_NOISE, BRAKE_NOISE if braking else 0.0)
    return np.asarray(scale * base + (share * most) ** 2 + 1.0)
