"""The drive that the nodes are fed with: a car that obeys its vehicle file, and a state of it."""

from __future__ import annotations

from functools import cache
import math
from pathlib import Path
import random

from evpinn_ros.core.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.core.estimation.state_file import Half, write_halves
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.core.vehicle.physics import RegenForm

VEHICLE = "tesla_model_3_lr"
OTHER_VEHICLE = "nissan_leaf"
MEAN, SWING, PERIOD = 14.0, 8.0, 20.0  # m/s, m/s, s
VOLTAGE, RESISTANCE = 360.0, 0.05  # V, Ohm
LEARNED = 60.0  # s of the drive that a warm start knows
RATE = 20.0  # Hz


@cache
def vehicle() -> Vehicle:
    """The car."""
    return load_vehicle(VEHICLE)


def readings(stamp_ns: int) -> tuple[SpeedReading, BatteryReading]:
    """Speed and battery of a moment, with the noise that tells sensors from numbers."""
    angle = 2 * math.pi * (stamp_ns % (int(PERIOD) * NANOSECONDS)) / NANOSECONDS / PERIOD
    speed = MEAN + SWING * math.sin(angle)
    acceleration = SWING * math.cos(angle) * 2 * math.pi / PERIOD
    power = vehicle().power(speed, acceleration, vehicle().initial, RegenForm.WHEEL_POWER)
    chance = random.Random(stamp_ns)
    current = -float(power) / VOLTAGE + chance.gauss(0.0, 0.2)
    voltage = VOLTAGE + RESISTANCE * current
    battery = BatteryReading(stamp_ns, voltage, current, 0.7)
    return SpeedReading(stamp_ns, speed + chance.gauss(0.0, 0.01)), battery


@cache
def learned_state(folder: Path) -> Path:
    """A state file of an estimator that has driven this car for a while."""
    estimator = OnlineEstimator(vehicle(), EstimatorSettings(), InlineWorker(lambda: 0.0))
    for step in range(round(LEARNED * 10)):
        for reading in readings(NANOSECONDS + step * NANOSECONDS // 10):
            for _ in estimator.add_reading(reading):
                pass
    path = folder / "learned.json"
    write_halves(path, {Half.LEARNED: estimator.export()})
    return path
