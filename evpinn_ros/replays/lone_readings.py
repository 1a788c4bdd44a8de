"""Readings that leap away from those on both sides and back, as no car does.

A real leap of the current makes the voltage sag; in a wrong reading one of the two leaps alone.
"""

from __future__ import annotations

import numpy as np

BEYOND = 8.0  # sigmas of what sag leaves of the voltage
FOLLOWS = 0.5  # of a voltage at most so much is left by sag, or it tells nothing of the current
# Where voltage and current are not of one moment, as of many dongles, many readings are far away:
MOST, NEAR = 0.9, 2.5  # so many are within so many sigmas, or nothing is told.
FEW = 30  # readings that tell nothing
BESIDE = 7  # readings whose median a lone one is compared with
LONGEST_STEP = 3.0  # s
HARDEST, LEAST_LEAP = 4.0, 1.0  # m/s^2 there and then back, and m/s


def lone_battery(voltage: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Mask of readings of the battery that leap alone; all of shape (n,), in order of time."""
    none = np.zeros(len(voltage), dtype=bool)
    volts, amperes = np.diff(voltage), np.diff(current)
    large = np.abs(amperes) > np.median(np.abs(amperes)) if len(voltage) > FEW else none
    if not large.any():
        return none
    resistance = float(np.median(volts[large] / amperes[large]))
    left = (volts - resistance * amperes)[large]
    if resistance <= 0.0 or _sigma(left) > FOLLOWS * _sigma(volts[large]):
        return none
    open_circuit = voltage - resistance * current
    around = np.pad(open_circuit, BESIDE // 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(around, BESIDE)
    away = np.abs(open_circuit - np.median(windows, axis=1))
    sigma = _sigma(away)
    return np.asarray((away > BEYOND * sigma) & (np.quantile(away, MOST) < NEAR * sigma))


def lone_speeds(time: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Mask of speeds that leap there and back; both of shape (n,), in order of time."""
    steps, change = np.diff(time), np.diff(speed)
    leaps = (np.abs(change) > LEAST_LEAP + HARDEST * steps) & (steps <= LONGEST_STEP)
    lone = np.zeros(len(time), dtype=bool)
    lone[1:-1] = leaps[1:] & leaps[:-1] & (change[1:] * change[:-1] < 0.0)
    return lone


def _sigma(values: np.ndarray) -> float:
    return 1.4826 * float(np.median(np.abs(values)))
