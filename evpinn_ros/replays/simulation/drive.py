"""A seeded driver on a seeded route over smooth hills: speed at 100 Hz, and its motion.

A route is a chain of legs, each with a speed limit and a speed at its end. The driver keeps to the
limit as traffic allows, brakes on v^2 = u^2 + 2 b d, and moves the pedals with bounded jerk.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from itertools import chain
import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.units import KMH
from evpinn_ros.replays.simulation.surroundings import slow_noise

SHORTEST_HILL, LONGEST_HILL = 250.0, 5000.0  # m, wavelengths
HILLS = 12
MAX_RMS_GRADE = 0.05


@dataclass(frozen=True, slots=True)
class HillyRoad:
    """Sum of sinusoidal hills, elevation zero at the start."""

    wave_number: np.ndarray  # shape (HILLS,), rad/m
    slope: np.ndarray  # shape (HILLS,), amplitude of the slope of each hill, 1
    phase: np.ndarray  # shape (HILLS,), rad

    def elevation(self, distance: np.ndarray) -> np.ndarray:
        """Elevation above the start, m, at distances along the road of shape (n,), m."""
        height = self.slope / self.wave_number
        waves = np.sin(np.outer(distance, self.wave_number) + self.phase) - np.sin(self.phase)
        return np.asarray(waves @ height)

    def mean_slope(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Climb per metre from `start` to `end`, m, shape (n,); exact for no distance too."""
        middle = np.outer((start + end) / 2, self.wave_number) + self.phase
        half_turns = np.outer(end - start, self.wave_number) / (2 * np.pi)
        return np.asarray((np.cos(middle) * np.sinc(half_turns)) @ self.slope)


def hilly_road(rms_grade: float, rng: np.random.Generator) -> HillyRoad:
    """A random road of this root mean square slope; its peaks are about three times as steep.

    Raises:
        InputError: the slope is outside 0 to `MAX_RMS_GRADE`.
    """
    if not 0 <= rms_grade <= MAX_RMS_GRADE:
        raise InputError(f"rms grade {rms_grade:g} is outside [0, {MAX_RMS_GRADE:g}]")
    wavelength = np.exp(rng.uniform(np.log(SHORTEST_HILL), np.log(LONGEST_HILL), HILLS))
    slope = np.full(HILLS, rms_grade * np.sqrt(2 / HILLS))
    return HillyRoad(2 * np.pi / wavelength, slope, rng.uniform(0, 2 * np.pi, HILLS))


SAMPLE_RATE = 100  # Hz, of all true signals
DRIVER_RATE = 10  # Hz, at which the driver decides
SMOOTHING = 0.15  # s, time over which driveline and tyres smooth the speed
LEAST_DURATION, MOST_DURATION = 10.0, 86_400.0  # s
START_WAIT = 6.0  # s standing at the start

REACTION = 0.8  # s, in which the driver closes a difference of speed
JERK = 2.0  # m/s^3, bound of the pedals' movement
SPECIFIC_POWER = 45.0  # W/kg, most that a driver demands
TRAFFIC_MEMORY = 8.0  # s
TRAFFIC_SPREAD = 0.05  # relative 1-sigma of the speed that traffic allows
FOOT_UNREST, FOOT_MEMORY = 0.15, 1.0  # m/s^2, s: noise of the pedal


class DriveKind(str, Enum):
    """Kind of road of a drive."""

    URBAN = "urban"
    HIGHWAY = "highway"
    MIXED = "mixed"


class Leg(NamedTuple):
    """A leg: length, m; limit and end speed, m/s; wait at its end, s; accelerations, m/s^2."""

    length: float
    limit: float
    end_speed: float
    wait: float
    braking: float
    pickup: float


@dataclass(frozen=True, slots=True)
class IntervalMotion:
    """Motion at the middle of each interval, shape (n,): energies add up exactly."""

    time: np.ndarray  # s from the start
    speed: np.ndarray  # m/s, never negative
    acceleration: np.ndarray  # m/s^2
    elevation: np.ndarray  # m above the start
    grade: np.ndarray  # rad, positive uphill


def motion_on(road: HillyRoad, speed: np.ndarray) -> IntervalMotion:
    """The motion on a road, shape (n,), from speeds, m/s, shape (n + 1,), at SAMPLE_RATE."""
    step = 1 / SAMPLE_RATE
    middle = (speed[1:] + speed[:-1]) / 2
    distance = np.concatenate(([0.0], np.cumsum(middle) * step))
    slope = road.mean_slope(distance[:-1], distance[1:])
    elevation = road.elevation(distance)
    return IntervalMotion(
        time=(np.arange(middle.size) + 0.5) * step,
        speed=middle,
        acceleration=np.diff(speed) / step,
        elevation=(elevation[1:] + elevation[:-1]) / 2,
        grade=np.arcsin(slope),
    )


def drive_speed(kind: DriveKind, duration_s: float, rng: np.random.Generator) -> np.ndarray:
    """Speed, m/s, shape (duration_s * SAMPLE_RATE + 1,), from standstill; or InputError."""
    if not LEAST_DURATION <= duration_s <= MOST_DURATION:
        bounds = f"[{LEAST_DURATION:g}, {MOST_DURATION:g}]"
        raise InputError(f"a drive of {duration_s:g} s is outside {bounds} s")
    steps = math.ceil(duration_s * DRIVER_RATE) + 1
    decided = _follow(_route(kind, duration_s, rng), *_moods(steps, rng))
    time = np.arange(round(duration_s * SAMPLE_RATE) + 1) / SAMPLE_RATE
    sharp = np.interp(time, np.arange(steps) / DRIVER_RATE, decided)
    smooth = gaussian_filter1d(sharp, SMOOTHING * SAMPLE_RATE, mode="nearest")
    return np.asarray(np.maximum(smooth, 0.0))


def _route(kind: DriveKind, duration_s: float, rng: np.random.Generator) -> Iterator[Leg]:
    endless = _town(math.inf, rng)
    if kind is DriveKind.URBAN:
        return endless
    if kind is DriveKind.HIGHWAY:
        return chain(_town(250.0, rng), _motorway(28.0 * (duration_s - 110.0), rng), endless)
    return chain(_town(3.0 * duration_s, rng), _motorway(11.0 * duration_s, rng), endless)


def _town(length: float, rng: np.random.Generator) -> Iterator[Leg]:
    driven = 0.0
    while driven < length:
        limit = rng.choice([30.0, 40.0, 50.0, 50.0, 60.0]) * KMH
        block = rng.uniform(120.0, 450.0)
        event = rng.uniform()
        if event < 0.5:
            yield _leg(block, limit, 0.0, rng.uniform(6.0, 30.0), rng)
            for _ in range(rng.integers(1, 4) if event < 0.15 else 0):
                yield _leg(rng.uniform(7.0, 25.0), 3.5, 0.0, rng.uniform(2.0, 6.0), rng)
        elif event < 0.75:
            yield _leg(block, limit, rng.uniform(4.0, 7.0), 0.0, rng)
        else:
            yield _leg(block, limit, math.inf, 0.0, rng)
        driven += block


def _motorway(length: float, rng: np.random.Generator) -> Iterator[Leg]:
    yield _leg(220.0, 50 * KMH, 11.0, 0.0, rng)
    driven = 0.0
    while driven < length:
        section = rng.uniform(500.0, 2500.0)
        jam = rng.uniform() < 0.25
        limit = rng.uniform(80.0, 95.0) if jam else rng.choice([100.0, 110.0, 120.0, 130.0])
        length_now = section / 3 if jam else section
        yield _leg(length_now, limit * KMH, math.inf, 0.0, rng, braking=(0.5, 1.1))
        driven += length_now
    yield _leg(400.0, 90 * KMH, 10.0, 0.0, rng)


def _leg(
    length: float,
    limit: float,
    end_speed: float,
    wait: float,
    rng: np.random.Generator,
    braking: tuple[float, float] = (0.7, 1.7),
) -> Leg:
    """A leg with random acceleration and braking, sometimes hard."""
    brakes = (2.6, 3.4) if rng.uniform() < 0.08 else braking
    return Leg(length, limit, end_speed, wait, rng.uniform(*brakes), rng.uniform(0.8, 2.1))


def _moods(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Share of the limit that traffic allows, and noise of the pedal, m/s^2, shape (count,)."""
    time = np.arange(count) / DRIVER_RATE
    traffic = 0.97 + TRAFFIC_SPREAD * slow_noise(time, TRAFFIC_MEMORY, rng)
    return traffic, FOOT_UNREST * slow_noise(time, FOOT_MEMORY, rng)


def _follow(route: Iterator[Leg], traffic: np.ndarray, unrest: np.ndarray) -> np.ndarray:
    """Speed of the driver at DRIVER_RATE, m/s, shape (n,) as of `_moods`."""
    step = 1 / DRIVER_RATE
    speeds = np.zeros(traffic.size)
    leg = next(route)
    left, wait, speed, acceleration = leg.length, START_WAIT, 0.0, 0.0
    for i, (share, twitch) in enumerate(zip(traffic.tolist(), unrest.tolist(), strict=True)):
        if wait > 0:
            wait -= step
            continue
        wish = _wish(leg, left, speed, leg.limit * share) + twitch
        acceleration += min(max(wish - acceleration, -JERK * step), JERK * step)
        speed = max(speed + acceleration * step, 0.0)
        left -= speed * step
        stopped = leg.end_speed == 0 and left < 1.0 and speed < 0.2
        if stopped:
            speed, acceleration = 0.0, 0.0
        if stopped or (leg.end_speed > 0 and left <= 0):
            wait = leg.wait
            leg = next(route)
            left = leg.length
        speeds[i] = speed
    return speeds


def _wish(leg: Leg, left: float, speed: float, allowed: float) -> float:
    left = max(left, 0.0)
    approach = math.sqrt(leg.end_speed**2 + 2 * leg.braking * left)
    approach = min(approach, leg.end_speed + left / REACTION)  # ease into a stop
    target = min(allowed, approach)
    planned = -leg.braking if approach <= allowed and speed > 0.8 * approach else 0.0
    pickup = min(leg.pickup, SPECIFIC_POWER / max(speed, 1.0))
    wish = (target - speed) / REACTION + planned
    return min(max(wish, -1.5 * leg.braking), pickup)
