"""Distance, time and measured energy of a drive."""

from __future__ import annotations

from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.common.arrays import chosen_rows
from evpinn_ros.core.energy.quadrature import MAX_GAP, joined
from evpinn_ros.core.estimation.learner import CHARGING_POWER
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED
from evpinn_ros.replays.history import Drive, lone_speeds
from evpinn_ros.replays.scoring import Span, known_at

LEAST_CHANGE = 0.005  # share of distance or energy; a smaller one due to outliers is not reported


class DrivenSteps(NamedTuple):
    """Steps of a drive between readings, without gaps; shape (n,) each."""

    end: np.ndarray  # time at their end, s
    seconds: np.ndarray  # duration
    speed: np.ndarray  # in the middle, m/s
    distance: np.ndarray  # m
    energy: np.ndarray  # measured, J; 0 in steps of speed alone


class Counted(NamedTuple):
    """Totals of a drive, from admitted readings alone."""

    distance: float  # m
    seconds: float  # with recorded speed
    energy: float  # net from the battery, J, while speed is known; NaN without a battery
    known: float  # distance with that energy measured, m
    measured: float  # seconds with that energy measured, or the standing car charged
    charged: float  # energy from a charger while the car stood, J; in no other figure


def counted(drive: Drive) -> Counted:
    """Totals of a drive, as all texts and pages show them."""
    moved = travelled(drive)
    steps, charging = _battery_steps(drive)
    drawn = chosen_rows(steps, ~charging)
    return Counted(
        distance=float(moved.distance.sum()),
        seconds=float(moved.seconds.sum()),
        energy=float(drawn.energy.sum()) if len(drive.measured) else math.nan,
        known=float(drawn.distance.sum()),
        measured=float(steps.seconds.sum()),
        charged=-float(steps.energy[charging].sum()),
    )


def without_lone(drive: Drive) -> tuple[Counted, int] | None:
    """Totals without lone outliers, and their number; None if the totals hardly change."""
    rows = rising(drive.speed)
    lone_speed = lone_speeds(*rows.T)
    lone = drive.lone if len(drive.lone) == len(drive.measured) else np.zeros(0, dtype=bool)
    if not (lone_speed.any() or lone.any()):
        return None
    measured = drive.measured[~lone] if len(lone) else drive.measured
    total = counted(drive)
    kept = counted(replace(drive, speed=rows[~lone_speed], measured=measured))
    pairs = ((total.distance, kept.distance), (total.energy, kept.energy))
    changed = any(abs(after - before) > LEAST_CHANGE * abs(before) for before, after in pairs)
    return (kept, int(lone_speed.sum() + lone.sum())) if changed else None


def travelled(drive: Drive) -> DrivenSteps:
    """Steps between readings of the speed."""
    rows = rising(drive.speed)
    return _steps(rows, np.zeros(len(rows)), np.ones(len(rows), dtype=bool))


def measured_steps(drive: Drive) -> DrivenSteps:
    """Steps between battery readings in which speed is known, without charging."""
    steps, charging = _battery_steps(drive)
    return chosen_rows(steps, ~charging)


def charged(drive: Drive, span: Span | None = None) -> float:
    """Energy from a charger while the car stood, J, in the drive or a span of it."""
    steps, charging = _battery_steps(drive)
    if span is not None:
        charging &= span.holds(steps.end)
    return -float(steps.energy[charging].sum())


def _battery_steps(drive: Drive) -> tuple[DrivenSteps, np.ndarray]:
    """Steps with speed and battery, and a mask of those that charge the standing car, (n,)."""
    time, power = drive.measured.T
    speed, is_known = known_at(rising(drive.speed), time)
    steps = _steps(np.column_stack((time, speed)), power, is_known)
    charging = steps.energy < CHARGING_POWER * steps.seconds
    return steps, charging & (steps.speed < STANDSTILL_SPEED)


def _steps(rows: np.ndarray, power: np.ndarray, known: np.ndarray) -> DrivenSteps:
    time, speed = rows[:, 0], np.abs(rows[:, 1])
    steps = np.diff(time)
    middle = (speed[1:] + speed[:-1]) / 2
    energy = (power[1:] + power[:-1]) / 2 * steps
    all_steps = DrivenSteps(time[1:], steps, middle, middle * steps, energy)
    return chosen_rows(all_steps, known[1:] & known[:-1] & joined(steps, MAX_GAP))


def rising(rows: np.ndarray) -> np.ndarray:
    """A series (time and value, shape (n, 2)) in order of time."""
    sorted_rows: np.ndarray = rows[np.argsort(rows[:, 0], kind="stable")]
    return sorted_rows
