import numpy as np
import pytest

from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.profile import load_profile
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    MotorReading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.replays.simulation.car import draw_car
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import EPOCH_NS, simulate

pytestmark = pytest.mark.slow

CAR = load_vehicle("tesla_model_3_lr")


def of(drive, kind) -> list:
    return [reading for reading in drive.readings if isinstance(reading, kind)]


def seconds(readings) -> np.ndarray:
    return np.array([reading.stamp_ns - EPOCH_NS for reading in readings]) / NANOSECONDS


def test_optional_sensors_change_nothing_else():
    plain = simulate(DriveKind.URBAN, CAR, 60.0, 3)
    more = simulate(DriveKind.URBAN, CAR, 60.0, 3, altitude=True, temperature=True)
    assert more.frames == plain.frames
    height = np.array([reading.altitude for reading in of(more, AltitudeReading)])
    truth = np.interp(
        seconds(of(more, AltitudeReading)), more.trace.motion.time, more.trace.motion.elevation
    )
    assert len(height) > 55 and 0.05 < np.std(height - truth) < 1.5
    assert len(of(more, TemperatureReading)) > 10
    assert not of(plain, AltitudeReading) and not of(plain, TemperatureReading)


def test_readings_are_what_the_decoder_makes_of_the_frames(drive):
    decoder = Decoder(load_profile("tesla_model_3"))
    decoded = [reading for frame in drive.frames for reading in decoder.decode(frame)]
    assert repr(decoded) == repr(list(drive.readings)) and not decoder.dropped


def test_stamps_rise_fit_a_candump_log_and_do_not_coincide(drive):
    stamps = np.array([reading.stamp_ns for reading in drive.readings])
    assert np.all(np.diff(stamps) >= 0) and not np.any(stamps % 1000)
    assert stamps[0] >= EPOCH_NS and stamps[-1] < EPOCH_NS + 240 * NANOSECONDS
    speed, battery = (seconds(of(drive, kind)) for kind in (SpeedReading, BatteryReading))
    assert np.std(np.diff(speed)) > 0.0005  # jitter
    assert 0.9 * 2400 < min(len(speed), len(battery)) < 2400  # some are lost
    assert np.median(np.abs(speed[: len(battery)] - battery[: len(speed)])) > 0.001


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_current_beyond_the_signal_reads_as_its_limit(seed):
    """A loaded Leaf takes more than the 511 A that its signal can show: the car goes on."""
    leaf, heavy = load_vehicle("nissan_leaf"), {"mass": 3000.0, "mu": 0.95}
    drive = simulate(DriveKind.MIXED, leaf, 200.0, seed, car=heavy)
    currents = [reading.current for reading in of(drive, BatteryReading)]
    assert len(currents) > 1900 and -511.0 <= min(currents) <= max(currents) <= 400.0
    assert (min(currents) == -511.0) == (max(drive.trace.current) > 511.0)


@pytest.mark.parametrize("model", ["tesla_model_3_lr", "nissan_leaf", "chevrolet_bolt"])
def test_motor_torque_is_told_with_a_gain_of_the_car_and_changes_nothing_else(model):
    profile = {"can_profile": "tesla_model_3_2019"} if model == "chevrolet_bolt" else {}
    vehicle = load_vehicle(model)
    plain = simulate(DriveKind.URBAN, vehicle, 120.0, 3, **profile)
    more = simulate(DriveKind.URBAN, vehicle, 120.0, 3, motor_torque=True, **profile)
    assert repr([r for r in more.readings if not isinstance(r, MotorReading)]) == repr(
        list(plain.readings)
    )
    assert len(more.frames) > len(plain.frames)
    trace, motors = more.trace, of(more, MotorReading)
    time, torque = seconds(motors), np.array([reading.torque for reading in motors])
    speed = np.interp(time, trace.motion.time, trace.motion.speed)
    power = np.interp(time, trace.motion.time, trace.wheel_power + trace.friction_power)
    moving = speed > 1.0
    gear = more.car.drivetrain.gear_ratio / more.car.drivetrain.wheel_radius
    gain = np.polyfit((power / np.maximum(speed, 1.0) / gear)[moving], torque[moving], 1)[0]
    assert gain == pytest.approx(more.car.torque_gain, abs=0.01) and gain != 1.0
    assert np.abs(torque[speed == 0.0]).max() < 1.0
    turns = np.array([reading.speed for reading in motors])
    if model == "chevrolet_bolt":  # a profile without the speed of the motor
        assert np.isnan(turns).all()
    else:
        np.testing.assert_allclose(turns, gear * speed, atol=0.3)


def test_motor_torque_needs_no_motor_in_the_profile():
    drive = simulate(
        DriveKind.URBAN, load_vehicle("nissan_leaf"), 60.0, 3,
        can_profile="tesla_model_3", motor_torque=True, equation=RegenForm.RECOVERY,
    )  # fmt: skip
    assert of(drive, MotorReading)
    rngs = map(np.random.default_rng, range(30))
    spread = [draw_car(CAR, CAR.initial, rng).torque_gain for rng in rngs]
    assert 0.01 < np.std(spread) < 0.03
