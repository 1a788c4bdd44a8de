"""A node that gets no processor for some seconds misses nothing of the other nodes."""

import signal
import time

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor

from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.processes import node_process
from evpinn_ros.topics import NAMESPACE
from evpinn_ros.topics.messages import named_vector, read_named_vector

STOP, PERIOD = 4.0, 0.1  # s


@pytest.mark.nightly
def test_four_seconds_without_the_processor_lose_no_power():
    rclpy.init()
    node, executor = rclpy.create_node("other", namespace=NAMESPACE), SingleThreadedExecutor()
    executor.add_node(node)
    powers, counted = factory.advertise(node, topics.POWER_SMOOTHED), []
    factory.subscribe(node, topics.ENERGY_STATE, lambda m: counted.append(read_named_vector(m)))
    start, sent = 1_700_000_000 * NANOSECONDS, 0

    def drive(seconds):
        nonlocal sent
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            stamp = start + round(sent * PERIOD * NANOSECONDS)
            powers.publish(named_vector(new_message, stamp, ["power"], [9e3], [90.0]))
            sent += 1
            due = time.monotonic() + PERIOD
            while time.monotonic() < due:
                executor.spin_once(timeout_sec=0.01)

    try:
        with node_process("energy", {"vehicle": "tesla_model_3_lr"}) as energy:
            end = time.monotonic() + 60.0
            while not counted:
                assert time.monotonic() < end, "timed out"
                drive(PERIOD)
            drive(1.0)
            energy.send_signal(signal.SIGSTOP)
            drive(STOP)
            energy.send_signal(signal.SIGCONT)
            drive(3.0)
    finally:
        executor.shutdown()
        rclpy.try_shutdown()
    first, last = counted[0].stamp_ns, counted[-1].stamp_ns
    expected = round((last - first) / (PERIOD * NANOSECONDS)) + 1
    print(f"{expected - len(counted)} of {expected} lost")
    assert len(counted) == expected and last > start + (sent - 5) * PERIOD * NANOSECONDS
