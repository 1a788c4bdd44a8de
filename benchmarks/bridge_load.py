"""The CAN bridge under a full bus: sender, bridge and subscriber in a process each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import time
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor

from benchmarks.can_traffic import (
    FRAMES_PER_TICK,
    GROUP,
    INTERFACE,
    PROFILE,
    TICKS,
    OwnProcess,
    bus_options,
    number_after,
    own_port,
    send_traffic,
)
from benchmarks.processor import processor_seconds
from evpinn_ros import topics
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.processes import START_TIMEOUT, node_process, own_network
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.topics import NAMESPACE, Topic
from evpinn_ros.topics.node_parameters import Value

SETTLE = 2.0  # s until publisher and subscriber surely know of each other
LAST_REPORT = 5.0  # s in which the bridge tells of the last frame
SPIN = 0.1  # s
VEHICLE = "tesla_model_3_lr"


@dataclass(frozen=True, slots=True)
class Load:
    """Results of the bridge on a full bus."""

    seconds: float  # of traffic
    frames_sent: int  # by the sender
    frames_received: int  # by the bridge, as it says on /diagnostics
    readings_sent: int  # battery frames among them
    readings_heard: int  # `battery/state` at the subscriber
    core_share: float  # of one core, that the bridge's process took while the traffic ran
    # from the sender's call to the subscriber's callback: p50, p99 and largest
    latency_ms: tuple[float, float, float]


def measure_load(seconds: float, progress: Callable[[float], None]) -> Load:
    """Run the bridge under `FRAMES_PER_TICK` x `TICKS` frames a second.

    `progress` takes the seconds done.

    Raises:
        InputError: no multicast here, no /proc, or the bridge did not come up.
    """
    own_network()
    rclpy.init(args=[])
    listener = _Listener()
    try:
        with _bridge(own_port()) as pid:
            listener.await_bridge()
            with OwnProcess(send_traffic, own_port(), seconds) as sender:
                listener.spin_until(lambda: bool(listener.battery), START_TIMEOUT)
                cpu, begin = processor_seconds(pid), time.monotonic()
                while not sender.done():
                    listener.spin()
                    progress(time.monotonic() - begin)
                share = (processor_seconds(pid) - cpu) / (time.monotonic() - begin)
                times = sender.result()
            sent = round(seconds * TICKS) * FRAMES_PER_TICK
            listener.spin_until(lambda: listener.frames() == sent, LAST_REPORT)
    finally:
        rclpy.try_shutdown()
    return Load(
        seconds=seconds,
        frames_sent=sent,
        frames_received=listener.frames(),
        readings_sent=len(times),
        readings_heard=len(listener.battery),
        core_share=share,
        latency_ms=_latencies(times, listener.battery),
    )


class _Listener:
    """The far end: every topic of the bridge, and the time at which a battery state came."""

    def __init__(self) -> None:
        self._node = rclpy.create_node("listener", namespace=NAMESPACE)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._values: dict[str, str] = {}
        self.battery: list[tuple[int, float]] = []
        self._listen(topics.BATTERY, self._take_battery)
        self._listen(topics.DIAGNOSTICS, self._take_diagnostics)
        for topic in (topics.SPEED, topics.BATTERY_VOLTAGE, topics.BATTERY_CURRENT):
            self._listen(topic, lambda _: None)

    def await_bridge(self) -> None:
        """Wait until the bridge reads its bus and is known."""
        self.spin_until(lambda: self._values.get("bus") in ("open", "silent"), START_TIMEOUT)
        end = time.monotonic() + SETTLE
        while time.monotonic() < end:
            self.spin()

    def frames(self) -> int:
        """Frames of all ids that the bridge says it has read."""
        return int(self._values.get("bus.frames", 0))

    def spin(self) -> None:
        """Take what comes next."""
        self._executor.spin_once(timeout_sec=SPIN)

    def spin_until(self, condition: Callable[[], bool], seconds: float) -> None:
        """Spin until it is so, or the time is over."""
        end = time.monotonic() + seconds
        while not condition() and time.monotonic() < end:
            self.spin()

    def _listen(self, topic: Topic, callback: Callable[[Any], None]) -> None:
        factory.subscribe(self._node, topic, callback)

    def _take_battery(self, message: Any) -> None:
        self.battery.append((time.time_ns(), message.voltage))

    def _take_diagnostics(self, message: Any) -> None:
        for status in message.status:
            if "can_bridge: " in status.name:
                self._values = {pair.key: pair.value for pair in status.values}


@contextmanager
def _bridge(port: int) -> Iterator[int]:
    """The bridge's executable on the bus; gives its process id."""
    options = " ".join(f"{name}={value}" for name, value in bus_options(port).items())
    parameters: dict[str, Value] = {
        "vehicle": VEHICLE,
        "can_profile": PROFILE,
        "interface": INTERFACE,
        "channel": GROUP,
        "bitrate": 0,
        "bus_options": options,
    }
    with node_process("can_bridge", parameters) as process:
        yield process.pid


def _latencies(
    sent_ns: list[int], received: list[tuple[int, float]]
) -> tuple[float, float, float]:
    """From sending to hearing, ms: p50, p99 and largest; the voltage tells which frame it was."""
    delays, number = [], 0
    for arrived_ns, volts in received:
        number = number_after(number, volts)
        delays.append((arrived_ns - sent_ns[number]) / NANOSECONDS * 1000)
    p50, p99, largest = np.quantile(delays, (0.5, 0.99, 1.0))
    return float(p50), float(p99), float(largest)
