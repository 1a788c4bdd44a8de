"""Delays and memory of the nodes in a driving car; each node and the car are processes.

The car publishes messages and receives bytes, because unpacking an answer is no part of the delay.
The floor is a node of a few lines that answers each message at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
import math
import os
import struct
import subprocess
import sys
import time
from typing import Any, NamedTuple

import numpy as np
import rclpy

from benchmarks.plan_load import ANSWER_TIMEOUT, PAUSE, VEHICLE, WARM_UP, speed_profile
from benchmarks.processes import resident_mb
from evpinn_ros import topics
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.factory import message_class, new_message
from evpinn_ros.nodes.processes import START_TIMEOUT, interrupt, node_process, own_network
from evpinn_ros.nodes.running import new_executor
from evpinn_ros.nodes.typed import PACKAGE, PLAN_SERVICE
from evpinn_ros.topics import NAMESPACE, Topic
from evpinn_ros.topics.messages import named_vector, stamp_ns
from evpinn_ros.topics.readings import battery_message, speed_message

ANSWERS = (topics.POWER_PREDICTED, topics.POWER_MEASURED, topics.ENERGY_STATE)
SETTLE = 3.0  # s of driving that are not counted, once every topic was heard
WARM_UP_RATE = 10.0  # Hz
BUS_RATE = 100.0  # Hz of both frames while memory is measured
CAN_PROFILE, GROUP = "tesla_model_3", "239.74.163.6"


class Delay(NamedTuple):
    """Delay from publishing a message to receiving its answer."""

    p50_ms: float
    p99_ms: float
    unanswered: int  # messages without an answer


def measure_topics(
    rate: float, seconds: int, progress: Callable[[float], None], *, floor: bool = False
) -> dict[str, Delay]:
    """Drive with speeds and battery messages at `rate`, Hz; returns delays by topic.

    The stamp of `energy/state` is that of the newest energy in it. `floor`: measure the node that
    answers at once.

    Raises:
        InputError: the nodes did not come up.
    """
    with _driving(_echoing() if floor else _nodes("estimator", "energy")) as car:
        car.drive_at(rate)
        car.spin(SETTLE)
        first = len(car.sent)
        for second in range(seconds):
            car.spin(1.0)
            progress(second)
        sent = car.sent[first:]
        car.spin(SETTLE)  # hears the last ones under the same load
        return {topic.name: _delay(car.heard[topic], sent) for topic in ANSWERS}


def measure_calls(
    points: int,
    calls: int,
    rate: float,
    progress: Callable[[float], None],
    *,
    floor: bool = False,
) -> Delay:
    """Call the typed service with one plan `calls` times, while the car drives.

    `rate`, Hz, is that of the car's messages; 0: it sends none.

    Raises:
        InputError: the nodes did not come up, or left a call without an answer.
    """
    with _driving(_echoing() if floor else _nodes("estimator", "energy")) as car:
        plan, times = typed_plan(points), []
        car.drive_at(rate)
        for number in range(WARM_UP + calls):
            times.append(car.call(plan))
            progress(number)
            car.spin(PAUSE)
    p50, p99 = (1e3 * np.quantile(times[WARM_UP:], (0.5, 0.99))).tolist()
    return Delay(p50, p99, 0)


def measure_memory(seconds: float) -> dict[str, float]:
    """Resident memory of each of the three nodes after a drive over a CAN bus, MB.

    Raises:
        InputError: multicast for the bus or /proc is missing.
    """
    # Imported here, because the other measurements need no bus.
    import can

    from evpinn_ros.can.encoder import Encoder
    from evpinn_ros.can.profile import load_profile

    own_network()
    options = {"port": 20_000 + os.getpid() % 20_000, "hop_limit": 0}
    text = " ".join(f"{name}={value}" for name, value in options.items())
    bus_parameters = {
        "interface": "udp_multicast", "channel": GROUP, "bitrate": 0, "bus_options": text,
    }  # fmt: skip
    encoder = Encoder(load_profile(CAN_PROFILE))
    try:
        bus = can.Bus(GROUP, interface="udp_multicast", **options)
    except (OSError, can.CanError) as error:
        raise InputError(f"no multicast here: {error}") from error
    with bus, _nodes("estimator", "energy", "can_bridge", **bus_parameters) as nodes:
        begin = time.monotonic()
        for number in range(round(BUS_RATE * seconds)):
            time.sleep(max(begin + number / BUS_RATE - time.monotonic(), 0.0))
            speed, battery = readings(number / BUS_RATE, 0)
            for frame in (encoder.speed(speed), encoder.battery(battery)):
                sent = can.Message(
                    arbitration_id=frame.can_id, data=frame.data, is_extended_id=False
                )
                bus.send(sent)
        return {name: resident_mb(process.pid) for name, process in nodes.items()}


def readings(moment: float, stamp: int) -> tuple[SpeedReading, BatteryReading]:
    """Speed and battery of a car in town at a moment, s."""
    speed = 10.0 - 10.0 * math.cos(moment / 8.0)
    acceleration = 1.25 * math.sin(moment / 8.0)
    power = 600.0 + speed * (180.0 + 0.4 * speed**2 + 1900.0 * acceleration)
    return SpeedReading(stamp, speed), BatteryReading(stamp, 350.0, -power / 350.0)


def typed_plan(points: int) -> Any:
    """The drive of `speed_profile` as evpinn_msgs/Plan."""
    rows = speed_profile(0, points).points
    distance, elevation = zip(*(row.positions for row in rows), strict=True)
    return new_message(
        "evpinn_msgs/msg/Plan",
        time=[float(row.time_from_start.sec) for row in rows],
        distance=list(distance),
        speed=[row.velocities[0] for row in rows],
        elevation=list(elevation),
    )


def _delay(heard: Mapping[int, int], sent: Sequence[int]) -> Delay:
    """Delays of the answers, their arrivals by stamp, to messages sent with these stamps."""
    delays = [heard[stamp] - stamp for stamp in sent if stamp in heard]
    p50, p99 = np.quantile(np.array(delays) / 1e6, (0.5, 0.99)).tolist()
    return Delay(p50, p99, len(sent) - len(delays))


@contextmanager
def _nodes(*names: str, **parameters: Any) -> Iterator[Mapping[str, subprocess.Popen[bytes]]]:
    with ExitStack() as stack:
        given = {"vehicle": VEHICLE, **parameters}
        yield {name: stack.enter_context(node_process(name, given)) for name in names}


@contextmanager
def _echoing() -> Iterator[None]:
    process = subprocess.Popen([sys.executable, "-m", __name__], stdin=subprocess.DEVNULL)
    try:
        yield
    finally:
        interrupt(process)


@contextmanager
def _driving(nodes: Any) -> Iterator[_Car]:
    """A car whose messages the nodes answer."""
    own_network()
    rclpy.init(args=[])
    try:
        car = _Car()
        with nodes:
            car.warm_up()
            yield car
    finally:
        rclpy.try_shutdown()


class _Car:
    """Publishes what a car measures, receives the answers, and asks for plans.

    Attributes:
        sent: stamps of its messages, ns.
        heard: arrivals of the answers by stamp, ns, for each topic.
    """

    def __init__(self) -> None:
        self._node = rclpy.create_node("car", namespace=NAMESPACE)
        self._executor = new_executor()
        self._executor.add_node(self._node)
        self.sent: list[int] = []
        self.heard: dict[Topic, dict[int, int]] = {topic: {} for topic in ANSWERS}
        self._step, self._moment, self._due = math.inf, 0.0, math.inf
        self._speed = factory.advertise(self._node, topics.SPEED)
        self._battery = factory.advertise(self._node, topics.BATTERY)
        for topic, arrivals in self.heard.items():
            factory.subscribe(self._node, topic, partial(self._take, arrivals), raw=True)
        self._client: Any = None

    def _take(self, arrivals: dict[int, int], data: bytes) -> None:
        sec, nanosec = struct.unpack_from("<iI", data, 4)  # behind four bytes of encoding
        arrivals.setdefault(sec * NANOSECONDS + nanosec, time.time_ns())

    def drive_at(self, rate: float) -> None:
        """Publish speed and battery at this rate, Hz, from now on; 0 stops."""
        self._step = 1.0 / rate if rate else math.inf
        self._due = time.monotonic() + self._step

    def spin(self, seconds: float, done: Callable[[], object] = bool) -> bool:
        """Publish what is due and receive, for a time or until `done`; returns whether done."""
        end = time.monotonic() + seconds
        while not done():
            now = time.monotonic()
            if now >= end:
                return False
            if now >= self._due:
                self._publish()
            self._executor.spin_once(timeout_sec=max(min(end, self._due) - now, 0.0))
        return True

    def _publish(self) -> None:
        self._due += self._step
        self._moment += self._step
        self.sent.append(time.time_ns())
        speed, battery = readings(self._moment, self.sent[-1])
        self._speed.publish(speed_message(new_message, speed))
        self._battery.publish(battery_message(new_message, battery))

    def warm_up(self) -> None:
        """Drive until every topic was heard, and `SETTLE` longer."""
        self.drive_at(WARM_UP_RATE)
        if not self.spin(START_TIMEOUT, lambda: all(self.heard.values())):
            raise InputError(f"the nodes did not come up within {START_TIMEOUT:g} s")
        self.spin(SETTLE)

    def call(self, plan: Any) -> float:
        """Ask the service for a plan; s until its answer."""
        kind = message_class(PLAN_SERVICE)
        if self._client is None:
            self._client = self._node.create_client(kind, "energy/estimate_plan")
            self.spin(START_TIMEOUT, self._client.service_is_ready)
            self.spin(SETTLE)  # until the service knows the client too
        request, answered = kind.Request(plans=[plan]), []
        begin = time.perf_counter()
        future = self._client.call_async(request)
        future.add_done_callback(lambda _: answered.append(time.perf_counter()))
        if not self.spin(ANSWER_TIMEOUT, lambda: answered):
            raise InputError(f"the node 'energy' sent nothing for {ANSWER_TIMEOUT:g} s")
        for result in future.result().results:
            if result.refusal:
                raise InputError(f"the plan was refused: {result.refusal}")
        return answered[0] - begin


def _echo() -> None:
    """The floor: answers each message and each call at once."""
    rclpy.init()
    node, executor = rclpy.create_node("echo", namespace=NAMESPACE), new_executor()
    executor.add_node(node)

    def answer(*to: Topic) -> Callable[[Any], None]:
        outlets = [factory.advertise(node, topic) for topic in to]

        def take(message: Any) -> None:
            for outlet in outlets:
                outlet.publish(named_vector(new_message, stamp_ns(message), ["power"], [0.0]))

        return take

    factory.subscribe(node, topics.SPEED, answer(topics.POWER_PREDICTED, topics.ENERGY_STATE))
    factory.subscribe(node, topics.BATTERY, answer(topics.POWER_MEASURED))
    if factory.is_installed(PACKAGE):
        kind = message_class(PLAN_SERVICE)
        node.create_service(kind, "energy/estimate_plan", lambda _, response: response)
    with suppress(KeyboardInterrupt):
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    _echo()
