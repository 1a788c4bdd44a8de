#!/usr/bin/env python3
"""A mobile robot that delivers things in a hall: odometry and battery, with known truth.

    ros2 run evpinn_ros simulated_robot.py --ros-args -r __ns:=/ev
    python examples/simulated_robot.py --csv robot.csv --minutes 10     # needs no ROS

It weighs 85 kg and drives up to 1.3 m/s, stops, turns on the spot and waits. Its motors have
losses by friction and by the square of their force, its computer has a changing load, and braking
returns no energy. The node publishes `odom` at 10 Hz and `battery/state` at 5 Hz, as Nav2 robots
do; with --csv it writes the same drive as a table. It imports nothing of evpinn_ros.
"""

import argparse
from collections.abc import Iterator
import csv
from dataclasses import dataclass
import math
import os
from pathlib import Path
import random
import sys
from typing import Any

STEP = 0.1  # s
BATTERY_EVERY = 2  # steps
MASS, ROTATING = 85.0, 1.08  # kg, 1
ROLLING = 0.022  # coefficient, on concrete
DRAG = 0.3 * 1.1 * 0.6  # N per (m/s)^2
ACCELERATION = 0.5  # m/s^2
GEAR_LOSS, COPPER_LOSS, INVERTER = 3.0, 0.004, 0.92  # N, W/N^2, 1
COMPUTER = 52.0  # W
TURNING, TURN_SECONDS = 35.0, 2.5  # W, s on the spot
CELLS, RESISTANCE, CAPACITY = 26.6, 0.06, 25.0 * 3600.0  # V full, ohm, A s
SPEED_NOISE, CURRENT_STEP, VOLTAGE_STEP = 0.008, 0.02, 0.01  # m/s, A, V


@dataclass(frozen=True)
class Moment:
    """A step of the robot: what it measures, and the truth."""

    time: float  # s
    speed: float  # m/s
    voltage: float  # V
    current: float  # A drawn
    charge: float  # 0..1
    true_power: float  # W
    true_load: float  # W of it for computer, planning and turning
    battery_due: bool  # whether the battery is measured


def speeds(rng: random.Random) -> Iterator[tuple[float, bool]]:
    """True speed each step, m/s, and whether the robot turns on the spot."""
    while True:
        left, cruise = rng.uniform(4.0, 30.0), rng.uniform(0.5, 1.3)
        speed = 0.0
        while left > 0.0:
            allowed = min(cruise, math.sqrt(2.0 * ACCELERATION * left) + 0.02)
            change = min(max(allowed - speed, -2.0 * ACCELERATION * STEP), ACCELERATION * STEP)
            speed += change
            left -= speed * STEP
            yield speed, False
        for _ in range(round(TURN_SECONDS / STEP)):
            yield 0.0, True
        for _ in range(round(rng.choice((0.5, 2.0, 15.0)) / STEP)):
            yield 0.0, False


def motor_power(speed: float, before: float) -> float:
    """Power of the motors in a step that ends with this speed, m/s, W; braking gives nothing."""
    force = MASS * ROTATING * (speed - before) / STEP
    if speed > 0.0:
        force += MASS * 9.81 * ROLLING + GEAR_LOSS + DRAG * speed**2
    return max(0.0, force * (speed + before) / 2.0 + COPPER_LOSS * force**2) / INVERTER


def drive(seed: int = 0) -> Iterator[Moment]:
    """The robot's working day; the same seed gives the same day."""
    rng = random.Random(seed)
    before, charge, load = 0.0, 0.9, 0.0
    for index, (speed, turns) in enumerate(speeds(rng)):
        load += rng.gauss(0.0, 0.6) - STEP / 20.0 * load  # it plans now and then
        beside = COMPUTER + load + (TURNING if turns else 0.0)
        power = beside + motor_power(speed, before)
        open_voltage = CELLS - 1.4 * (1.0 - charge)
        current = power / open_voltage
        voltage = open_voltage - RESISTANCE * current
        charge -= current * STEP / CAPACITY
        measured = max(0.0, speed + rng.gauss(0.0, SPEED_NOISE)) if speed > 0.01 else 0.0
        yield Moment(
            time=index * STEP,
            speed=measured,
            voltage=round(voltage / VOLTAGE_STEP) * VOLTAGE_STEP,
            current=round(power / voltage / CURRENT_STEP) * CURRENT_STEP,
            charge=charge,
            true_power=power,
            true_load=beside,
            battery_due=index % BATTERY_EVERY == 0,
        )
        before = speed


def write_table(path: Path, minutes: float, seed: int) -> None:
    """Write a drive as a table that `evpinn replay` reads."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(("t_s", "speed_mps", "voltage_v", "current_a", "soc_pct"))
        for now in drive(seed):
            if now.time > 60.0 * minutes:
                return
            battery = (f"{now.voltage:.2f}", f"{now.current:.2f}", f"{100.0 * now.charge:.2f}")
            row = battery if now.battery_due else ("", "", "")
            table.writerow((f"{now.time:.2f}", f"{now.speed:.4f}", *row))


def run_node(seed: int, arguments: list[str]) -> None:
    """Publish the drive in real time until a signal ends it."""
    from nav_msgs.msg import Odometry
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.node import Node
    from sensor_msgs.msg import BatteryState

    class Robot(Node):
        def __init__(self) -> None:
            super().__init__("simulated_robot")
            self._moments = drive(seed)
            self._odom = self.create_publisher(Odometry, "odom", 10)
            self._battery = self.create_publisher(BatteryState, "battery/state", 10)
            self.create_timer(STEP, self._publish)

        def _publish(self) -> None:
            now, stamp = next(self._moments), self.get_clock().now().to_msg()
            odom = Odometry(child_frame_id="base_link")
            odom.header.stamp, odom.header.frame_id = stamp, "odom"
            odom.twist.twist.linear.x = now.speed
            self._odom.publish(odom)
            if now.battery_due:
                self._battery.publish(self._state(now, stamp))

        def _state(self, now: Moment, stamp: Any) -> BatteryState:
            battery = BatteryState(voltage=now.voltage, current=-now.current, present=True)
            battery.header.stamp, battery.percentage = stamp, now.charge
            return battery

    rclpy.init(args=arguments)
    try:
        rclpy.spin(Robot())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RuntimeError:  # from rclpy, if it was shut down within a call
        if rclpy.ok():
            raise
    finally:
        rclpy.try_shutdown()


def main() -> int:
    """Write a table or publish; gives the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--csv", type=Path, help="table to write, instead of publishing")
    parser.add_argument("--minutes", type=float, default=10.0, help="length of the table")
    parser.add_argument("--seed", type=int, default=0, help="seed of random numbers")
    given, others = parser.parse_known_args()
    if given.csv is not None:
        write_table(given.csv, given.minutes, given.seed)
    else:
        run_node(given.seed, [sys.argv[0], *others])
    return 0


if __name__ == "__main__":
    exit_code = main()
    sys.stdout.flush()
    # Without destroying publishers: Fast DDS may hang there while others leave.
    os._exit(exit_code)
