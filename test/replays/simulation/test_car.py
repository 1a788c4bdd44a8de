"""The books of a drive balance, and the car has what the five-parameter model lacks."""

import numpy as np
import pytest

from evpinn_ros.core.vehicle.physics import GRAVITY
from evpinn_ros.replays.simulation.car import STEP, Brakes, Drivetrain


def energy(power: np.ndarray) -> float:
    return float(np.sum(power)) * STEP


def test_battery_energy_is_what_became_of_it(drive):
    """Chemical energy = heat everywhere + air + tyres + what the car gained in motion and height.

    Every term is summed on its own; motion and height come from first and last moment alone.
    """
    car, trace, motion = drive.car, drive.trace, drive.trace.motion
    first = motion.speed[0] - motion.acceleration[0] * STEP / 2
    last = motion.speed[-1] + motion.acceleration[-1] * STEP / 2
    kinetic = 0.5 * car.mass * car.rotating_mass_factor * (last**2 - first**2)
    climb = np.sum(np.sin(motion.grade) * motion.speed) * STEP
    sinks = (
        energy(trace.current**2) * car.battery.resistance
        + energy(trace.auxiliary)
        + energy(trace.no_load_loss)
        + energy(trace.load_loss)
        + energy(trace.friction_power)
        + energy(trace.drag_power)
        + energy(trace.rolling_power)
        + kinetic
        + car.mass * GRAVITY * climb
    )
    assert energy(trace.open_circuit * trace.current) == pytest.approx(sinks, rel=1e-6)
    height = motion.elevation[-1] - motion.elevation[0]
    assert climb == pytest.approx(height, abs=0.02 * motion.speed.max() * STEP)


def test_efficiency_depends_on_torque_and_speed():
    drivetrain = Drivetrain()

    def efficiency(force: float, speed: float) -> float:
        loss = drivetrain.no_load_loss(np.array([speed])) + drivetrain.load_loss(force, speed)
        return force * speed / (force * speed + float(loss[0]))

    cruise, part, pull = (efficiency(force, 14.0) for force in (300.0, 1000.0, 4500.0))
    assert 0.8 < cruise < part < 0.95 and pull < part
    assert 0.5 < efficiency(4500.0, 1.0) < 0.8


@pytest.mark.parametrize(
    ("demand", "speed", "expected"),
    [
        (1000.0, 20.0, 1000.0),  # gentle: the motor alone
        (9000.0, 10.0, 3600.0),  # hard: 1.8 m/s^2 of 2000 kg
        (3500.0, 30.0, 2500.0),  # fast: 75 kW
        (1000.0, 2.1, 500.0),  # slow: half faded
        (1000.0, 1.0, 0.0),  # at the end: friction alone
    ],
)
def test_the_friction_brakes_take_what_the_motor_cannot(demand, speed, expected):
    force = Brakes().motor_force(np.array([demand]), np.array([speed]), mass=2000.0)
    assert force[0] == pytest.approx(expected)


def test_wind_and_auxiliary_loads_change_slowly_about_their_mean(drive):
    trace = drive.trace
    assert trace.auxiliary.mean() == pytest.approx(drive.car.mean_auxiliary, rel=1e-12)
    assert trace.auxiliary.std() > 0.03 * trace.auxiliary.mean()
    assert 0.4 < trace.head_wind.std() < 2.5 and np.abs(trace.head_wind).max() < 6
    assert np.abs(np.diff(trace.head_wind)).max() / STEP < 1.0
