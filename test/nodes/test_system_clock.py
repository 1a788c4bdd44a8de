"""The computer's own clock set back and ahead by hours under running nodes (libfaketime)."""

from contextlib import contextmanager
from importlib.metadata import distributions
import os
from pathlib import Path
import subprocess
import time

import pytest

from evpinn_ros.nodes import topics
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.faults.clocks import SystemClock, clock_setter
from evpinn_ros.nodes.messages import battery_message, read_named_vector, speed_message
from evpinn_ros.nodes.processes import node_command
from evpinn_ros.signals.readings import BatteryReading, SpeedReading

JAZZY = any(one.version.startswith("7.") for one in distributions(name="ros-rclpy"))
pytestmark = [
    pytest.mark.skipif(clock_setter() is None, reason="libfaketime is not installed"),
    pytest.mark.skipif(JAZZY, reason="Jazzy's Fast DDS hears half under libfaketime"),
]

POWER = 7000.0  # W
SECONDS = 2.5  # of driving after each step
STEPS = {-3 * 3600.0: "time went back by 1", 6 * 3600.0: "stamps leapt ahead by 2"}  # s


@contextmanager
def node(name, clock, folder):
    file = {"estimator": "state_file", "energy": "energy_file"}[name]
    values = {"vehicle": "tesla_model_3_lr", "time_jump_policy": "hold", file: folder / name}
    process = subprocess.Popen(
        node_command(name, values),
        env={**os.environ, **clock.environment},
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield
        process.terminate()
        _, said = process.communicate(timeout=20)
        assert process.returncode == 0 and "Traceback" not in said, said
    finally:
        process.kill()
        process.communicate()


def drive(bench, clock):
    """10 Hz in real time, stamped by the clock."""
    begin = time.monotonic()
    for tick in range(round(10 * SECONDS)):
        battery, speed = BatteryReading(clock(), 350.0, -20.0), SpeedReading(clock(), 12.0)
        bench.send(topics.BATTERY, battery_message(new_message, battery))
        bench.send(topics.SPEED, speed_message(new_message, speed))
        while time.monotonic() < begin + (tick + 1) / 10:
            bench.executor.spin_once(timeout_sec=0.02)


def energy(bench):
    return read_named_vector(bench.heard[topics.ENERGY_STATE][-1]).values["measured"]


def test_a_clock_that_is_set_stops_nothing_and_is_named(bench, tmp_path: Path):
    clock, heard = SystemClock(tmp_path), bench.heard
    with node("estimator", clock, tmp_path), node("energy", clock, tmp_path):
        bench.listen(topics.POWER_PREDICTED, topics.ENERGY_STATE, topics.DIAGNOSTICS)
        for topic in (topics.SPEED, topics.BATTERY):
            bench.publisher(topic)
        drive(bench, clock)  # until all have found each other
        for step, word in STEPS.items():
            clock.jump(step)
            before = energy(bench)
            heard[topics.DIAGNOSTICS].clear()
            drive(bench, clock)  # Fast DDS under libfaketime may wait two seconds for a timer
            count = len(heard[topics.POWER_PREDICTED])
            drive(bench, clock)
            assert len(heard[topics.POWER_PREDICTED]) - count > 5 * SECONDS
            # Nothing is integrated across hours: this stretch, and what was on its way before.
            assert 0.0 < energy(bench) - before < 3.0 * POWER * SECONDS
            # The timers of both went on, and tell the new time.
            now = clock() / 1e9
            reports = [m for m in heard[topics.DIAGNOSTICS] if abs(now - m.header.stamp.sec) < 60]
            assert len(reports) >= 2 * (SECONDS - 1.0), len(heard[topics.DIAGNOSTICS])
            told = " ".join(s.message for m in reports for s in m.status)
            assert word in told and "no power/smoothed" not in told, told
