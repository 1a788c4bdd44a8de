"""Sensors of a simulated car: lagging, noisy, rounded, with lost frames.

The path is that of a real car: true signal, sensor, CAN frame, decoder, reading. Each message of
10 Hz has its own phase.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from operator import attrgetter

import numpy as np

from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import CanProfile
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    MotorReading,
    Reading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.replays.simulation.car import STEP, Car, Trace
from evpinn_ros.replays.simulation.surroundings import slow_noise

SPEED_RATE, BATTERY_RATE, CHARGE_RATE = 10.0, 10.0, 1.0  # Hz
SPEED_LAG, BATTERY_LAG = 0.06, 0.03  # s, time constants of the car's own filters
SPEED_NOISE = 0.015  # m/s, 1-sigma
VOLTAGE_NOISE = 0.15  # V
CURRENT_NOISE = 0.4  # A
STILL = 0.05  # m/s, below which there is no wheel pulse and the speed is zero
JITTER = 0.002  # s, to either side
LOST = 0.002  # share of lost frames

MOTOR_RATE, MOTOR_LAG = 10.0, 0.02  # Hz, s
TORQUE_STEP, MOTOR_SPEED_STEP = 0.5, 0.1  # N m, rad/s (1 rpm): resolution of the inverter's own

ALTITUDE_RATE, TEMPERATURE_RATE = 1.0, 0.2  # Hz
ALTITUDE_NOISE = 0.15  # m, of one reading
ALTITUDE_DRIFT, ALTITUDE_DRIFT_MEMORY = 0.5, 60.0  # m, s: gusts and doors change the pressure
TEMPERATURE_NOISE = 0.2  # degrees Celsius
MICROSECOND = 1000  # ns, the resolution of a candump log


@dataclass(frozen=True, slots=True)
class SensorData:
    """Frames in the log, and the readings decoded from them; both in order of time."""

    frames: tuple[CanFrame, ...]
    readings: tuple[Reading, ...]


def sense(
    trace: Trace,
    profile: CanProfile,
    start_ns: int,
    rng: np.random.Generator,
    motors: Sequence[MotorReading] = (),
) -> SensorData:
    """Readings decoded from the bus of a car with this profile; signals saturate.

    `motors` go over the bus if the profile has a motor torque, and are added unchanged otherwise.

    Raises:
        InputError: the profile broadcasts no speed or battery, or the voltage is out of its range.
    """
    try:
        sent = _sent(trace, profile, start_ns, rng)
        encoder, on_bus = Encoder(profile), "motor" in profile.messages
        torque = [frame for reading in motors if on_bus for frame in encoder.motor(reading)]
    except ValueError as error:
        raise InputError(f"CAN profile '{profile.key}': {error}") from error
    arrives = rng.uniform(size=len(sent)) >= LOST
    kept = [frame for frame, here in zip(sent, arrives, strict=True) if here]
    kept += torque
    kept.sort(key=attrgetter("stamp_ns"))
    decoder = Decoder(profile)
    readings = (reading for frame in kept for reading in decoder.decode(frame))
    extra = () if on_bus else motors
    return SensorData(tuple(kept), (*readings, *extra))


def _sent(
    trace: Trace, profile: CanProfile, start_ns: int, rng: np.random.Generator
) -> list[CanFrame]:
    encoder = Encoder(profile)
    speeds = list(_speeds(trace, start_ns, rng))
    batteries = list(_batteries(trace, start_ns, rng))
    if {"speed", "battery"} <= profile.messages.keys():
        (speed,), (_, current) = (profile.messages[name].signals for name in ("speed", "battery"))
        speeds = [replace(reading, speed=speed.clipped(reading.speed)) for reading in speeds]
        batteries = [
            replace(reading, current=current.clipped(reading.current)) for reading in batteries
        ]
    frames = [encoder.speed(reading) for reading in speeds]
    frames += [encoder.battery(reading) for reading in batteries]
    if "state_of_charge" in profile.messages:
        every = round(BATTERY_RATE / CHARGE_RATE)
        frames += [encoder.state_of_charge(reading) for reading in batteries[::every]]
    return frames


def motor_readings(
    trace: Trace, car: Car, start_ns: int, rng: np.random.Generator
) -> list[MotorReading]:
    """Motor torque as estimated by the inverter, rounded and with an error of gain; and speed."""
    time, stamps = _moments(trace, MOTOR_RATE, start_ns, rng)
    speed = trace.motion.speed
    power = trace.wheel_power + trace.friction_power
    force = np.divide(power, speed, out=np.zeros_like(speed), where=speed > STILL)
    torque = car.torque_gain * _lagged(trace, car.drivetrain.torque(force), MOTOR_LAG, time)
    turning = car.drivetrain.turning(np.interp(time, trace.motion.time, speed))
    shown = (_rounded(torque, TORQUE_STEP), _rounded(turning, MOTOR_SPEED_STEP))
    arrives = rng.uniform(size=time.size) >= LOST
    shown_rows = zip(stamps, *shown, arrives, strict=True)
    return [MotorReading(stamp, *values) for stamp, *values, here in shown_rows if here]


def _rounded(values: np.ndarray, step: float) -> list[float]:
    return [float(value) for value in np.round(values / step) * step]


def altitudes(trace: Trace, start_ns: int, rng: np.random.Generator) -> list[Reading]:
    """Barometric altitude above the start, with noise and slow drift."""
    time, stamps = _moments(trace, ALTITUDE_RATE, start_ns, rng)
    drift = ALTITUDE_DRIFT * slow_noise(time, ALTITUDE_DRIFT_MEMORY, rng)
    noise = ALTITUDE_NOISE * rng.standard_normal(time.size)
    height = np.interp(time, trace.motion.time, trace.motion.elevation) + drift + noise
    return [AltitudeReading(*pair) for pair in zip(stamps, height.tolist(), strict=True)]


def temperatures(
    trace: Trace, celsius: float, start_ns: int, rng: np.random.Generator
) -> list[Reading]:
    """Readings of the outside thermometer at a mean of `celsius` degrees."""
    time, stamps = _moments(trace, TEMPERATURE_RATE, start_ns, rng)
    shown = celsius + TEMPERATURE_NOISE * rng.standard_normal(time.size)
    return [TemperatureReading(*pair) for pair in zip(stamps, shown.tolist(), strict=True)]


def _speeds(trace: Trace, start_ns: int, rng: np.random.Generator) -> Iterator[SpeedReading]:
    time, stamps = _moments(trace, SPEED_RATE, start_ns, rng)
    speed = _lagged(trace, trace.motion.speed, SPEED_LAG, time)
    noisy = speed + SPEED_NOISE * rng.standard_normal(time.size)
    shown = np.where(speed < STILL, 0.0, np.maximum(noisy, 0.0))
    for stamp, value in zip(stamps, shown.tolist(), strict=True):
        yield SpeedReading(stamp, value)


def _batteries(trace: Trace, start_ns: int, rng: np.random.Generator) -> Iterator[BatteryReading]:
    time, stamps = _moments(trace, BATTERY_RATE, start_ns, rng)
    noise = rng.standard_normal((2, time.size))
    voltage = _lagged(trace, trace.voltage, BATTERY_LAG, time) + VOLTAGE_NOISE * noise[0]
    drawn = _lagged(trace, trace.current, BATTERY_LAG, time) + CURRENT_NOISE * noise[1]
    charge = np.interp(time, trace.motion.time, trace.state_of_charge)
    columns = (voltage.tolist(), (-drawn).tolist(), charge.tolist())
    for stamp, volts, amperes, share in zip(stamps, *columns, strict=True):
        yield BatteryReading(stamp, volts, amperes, share)


def _moments(
    trace: Trace, rate: float, start_ns: int, rng: np.random.Generator
) -> tuple[np.ndarray, list[int]]:
    """Moments of a message with this rate, Hz: s from the start, shape (n,), and stamps, ns."""
    first = rng.uniform(JITTER, 1 / rate)
    time = np.arange(first, trace.motion.time[-1] - JITTER, 1 / rate)
    time = time + rng.uniform(-JITTER, JITTER, time.size)
    micro = np.round(time * (NANOSECONDS / MICROSECOND)).astype(np.int64)
    return time, (start_ns + micro * MICROSECOND).tolist()


def _lagged(trace: Trace, signal: np.ndarray, lag: float, time: np.ndarray) -> np.ndarray:
    keep = float(np.exp(-STEP / lag))
    # Plain Python: importing a library of filters takes longer than filtering this drive.
    new = ((1 - keep) * signal[1:]).tolist()
    filtered = list(accumulate(new, lambda last, x: x + keep * last, initial=float(signal[0])))
    return np.asarray(np.interp(time, trace.motion.time, filtered))
