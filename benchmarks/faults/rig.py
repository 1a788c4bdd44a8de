"""Far end of every topic: drives the car, receives what nodes publish, keeps the time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import count
import math
from pathlib import Path
import time
from typing import Any, TypeAlias

import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger

from benchmarks.faults.drive import RATE, readings
from benchmarks.faults.fault import RECOVERY
from evpinn_ros import topics
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.processes import START_TIMEOUT
from evpinn_ros.topics import NAMESPACE, Topic
from evpinn_ros.topics.messages import read_named_vector
from evpinn_ros.topics.readings import reading_message

OUTPUTS = (topics.POWER_PREDICTED, topics.POWER_SMOOTHED, topics.POWER_MEASURED)
RECORDED = (*OUTPUTS, topics.ENERGY_STATE, topics.IDENTIFIABLE)
WELL = (*OUTPUTS, topics.ENERGY_STATE)
MOST_KEPT = 50_000
SPIN = 0.01  # s
SLACK = 10  # predictions on their way when one looks
LONGEST = 15.0  # s in which a fault must be named
ANSWER_TIMEOUT = 10.0  # s

Sent: TypeAlias = tuple[Topic, Any]
Change: TypeAlias = Callable[[Iterable[Sent]], Iterable[Sent]]
"""Change by a fault to the messages of one moment."""


def unchanged(messages: Iterable[Sent]) -> Iterable[Sent]:
    """No fault."""
    return messages


def nothing(_: Iterable[Sent]) -> Iterable[Sent]:
    """The car sends nothing."""
    return ()


@dataclass(frozen=True, slots=True)
class NodeStatus:
    """One status of a node, and its arrival, s of a monotonic clock."""

    arrived: float
    name: str
    level: int
    text: str


class Rig:
    """Feeds nodes and listens to them, from this process.

    Attributes:
        folder: for the files of the campaign.
        received: messages of each output, with the time they came, s of a monotonic clock.
        sent: messages of speed sent so far.
        clock: gives the stamps, ns; a fault may set another.
    """

    def __init__(self, folder: Path) -> None:
        """Come up; rclpy is initialised already."""
        self.folder = folder
        self.received: dict[Topic, deque[tuple[float, Any]]] = {
            topic: deque(maxlen=MOST_KEPT) for topic in RECORDED
        }
        self.sent = 0
        self.clock: Callable[[], int] = time.time_ns
        self.node = rclpy.create_node("driver", namespace=NAMESPACE)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._publishers: dict[Topic, Any] = {}
        self._statuses: deque[NodeStatus] = deque(maxlen=MOST_KEPT)
        for topic in RECORDED:
            self._listen(topic)
        factory.subscribe(self.node, topics.DIAGNOSTICS, self._take_diagnostics)
        for topic in (topics.SPEED, topics.BATTERY):
            self.publisher(topic)

    def close(self) -> None:
        """Let go of the executor and the node."""
        self._executor.shutdown()
        self.node.destroy_node()

    # --- receiving ------------------------------------------------------------------------------

    def status(self, node: str, word: str, since: float) -> str | None:
        """The first text of a node since then that has the word."""
        for each in self._statuses:
            if each.arrived > since and each.name.startswith(node) and word in each.text:
                return each.text
        return None

    def status_of(self, node: str, words: Iterable[str], since: float) -> str | None:
        """The text for the first of several words that a node has used since then."""
        return next(filter(None, (self.status(node, word, since) for word in words)), None)

    def watch(self) -> Watch:
        """Count what happens from now on."""
        return Watch(self, time.monotonic(), self.sent)

    def complaints(self, since: float) -> list[str]:
        """Texts of all that was not OK since then."""
        return sorted(
            {each.text for each in self._statuses if each.arrived > since and each.level}
        )

    def is_well(self, node: str, since: float) -> bool:
        """True if a node's newest status since then is OK."""
        found = [
            each for each in self._statuses if each.arrived > since and each.name.startswith(node)
        ]
        return bool(found) and not any(each.level for each in found[-1:])

    def count(self, topic: Topic, since: float) -> int:
        """Messages received since then."""
        return sum(arrived > since for arrived, _ in self.received[topic])

    def faulty(self, since: float) -> str | None:
        """Internal fault that a node reported, or a number that is not finite in what it sent."""
        fault = self.status("", "internal fault", since)
        if fault is not None:
            return fault
        for topic, messages in self.received.items():
            for arrived, message in messages:
                if arrived > since and not all(map(math.isfinite, message.position)):
                    return f"{topic.name} is not finite"
        return None

    def recovered(self, since: float, wanted: Iterable[Topic] = WELL) -> float:
        """Seconds after which the first of each output came, inf while one is missing."""
        firsts = (
            next((arrived for arrived, _ in self.received[topic] if arrived > since), math.inf)
            for topic in wanted
        )
        return max(firsts) - since

    def learned(self) -> float:
        """Mass over eta as published last, kg; NaN before."""
        received = self.received[topics.IDENTIFIABLE]
        return read_named_vector(received[-1][1]).values["mass_over_eta"] if received else math.nan

    # --- driving -------------------------------------------------------------------------------

    def drive(
        self,
        seconds: float,
        change: Change = unchanged,
        until: Callable[[], bool] = lambda: False,
        rate: float = RATE,
    ) -> float:
        """Send speed and battery in real time, at most so long; gives the seconds it took."""
        begin = time.monotonic()
        for number in count():
            due = begin + number / rate
            if due - begin >= seconds or until():
                return time.monotonic() - begin
            self.spin_to(due)
            for topic, message in change(list(self.moment(self.clock()))):
                self.send(topic, message)
        raise AssertionError

    def drive_until_recovered(
        self, since: float, wanted: Iterable[Topic] = WELL, most: float = 2 * RECOVERY
    ) -> float:
        """Drive until each output came since then; gives the seconds until it did."""
        self.drive(most, until=lambda: self.recovered(since, wanted) < math.inf)
        return self.recovered(since, wanted)

    def drive_until_named(self, node: str, word: str, since: float, most: float = LONGEST) -> None:
        """Drive until a node's diagnostics have a word, for a time at most."""
        self.drive(most, until=lambda: self.status(node, word, since) is not None)

    def moment(self, stamp_ns: int) -> Iterator[Sent]:
        """Speed and battery of a moment."""
        speed, battery = readings(stamp_ns)
        yield topics.SPEED, reading_message(new_message, speed)
        yield topics.BATTERY, reading_message(new_message, battery)

    def send(self, topic: Topic, message: Any) -> None:
        """Publish one message."""
        self.sent += topic is topics.SPEED
        self.publisher(topic).publish(message)

    def publisher(self, topic: Topic) -> Any:
        """The publisher of a topic."""
        if topic not in self._publishers:
            self._publishers[topic] = factory.advertise(self.node, topic)
        return self._publishers[topic]

    def replace_publisher(self, topic: Topic, qos: Any) -> None:
        """Publish a topic with another quality of service from now on."""
        self.node.destroy_publisher(self.publisher(topic))
        kind = factory.message_class(topic.type_name)
        self._publishers[topic] = self.node.create_publisher(kind, topic.name, qos)

    def spin_to(self, due: float) -> None:
        """Receive until a time of the monotonic clock."""
        self._executor.spin_once(timeout_sec=0.0)
        while (left := due - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=min(left, SPIN))

    def rest(self, seconds: float) -> None:
        """Receive, and send nothing."""
        self.spin_to(time.monotonic() + seconds)

    def wait(
        self, condition: Callable[[], bool], what: str, seconds: float = START_TIMEOUT
    ) -> None:
        """Receive until it is so; InputError when it does not come to pass."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                raise InputError(f"{what}: not within {seconds:g} s")
            self._executor.spin_once(timeout_sec=SPIN)

    def call(self, service: str) -> Any:
        """Call a Trigger; gives the response, None without an answer."""
        future = self.begin_call(service)
        end = time.monotonic() + ANSWER_TIMEOUT
        while future is not None and not future.done() and time.monotonic() < end:
            self.drive(0.1)
        return future.result() if future is not None and future.done() else None

    def begin_call(self, service: str) -> Any:
        """Call a Trigger without waiting for the answer; None without a server."""
        client = self.node.create_client(Trigger, service)
        end = time.monotonic() + ANSWER_TIMEOUT
        while not client.service_is_ready() and time.monotonic() < end:
            self.drive(0.1)
        return client.call_async(Trigger.Request()) if client.service_is_ready() else None

    def subscribe(self, topic: Topic, callback: Callable[[Any], None]) -> Any:
        """Subscribe to one more topic."""
        return factory.subscribe(self.node, topic, callback)

    def _listen(self, topic: Topic) -> None:
        received = self.received[topic]
        self.subscribe(topic, lambda message: received.append((time.monotonic(), message)))

    def _take_diagnostics(self, message: Any) -> None:
        now = time.monotonic()
        for status in message.status:
            level = int.from_bytes(status.level, "little")
            name = status.name.rpartition("/")[2]  # all nodes are under one namespace here
            self._statuses.append(NodeStatus(now, name, level, status.message))


@dataclass(frozen=True, slots=True)
class Watch:
    """Messages sent and received by the rig since a moment, s of a monotonic clock."""

    rig: Rig
    begin: float
    sent_before: int

    @property
    def sent(self) -> int:
        """Speeds sent since then."""
        return self.rig.sent - self.sent_before

    @property
    def missing(self) -> int:
        """Speeds sent since then that were not predicted."""
        return self.sent - self.rig.count(topics.POWER_PREDICTED, self.begin)

    @property
    def lost(self) -> str:
        """The missing predictions, in words."""
        return f"{max(self.missing, 0)} of {self.sent} predictions"


def stamped(message: Any, stamp_ns: int) -> Any:
    """The message, with another stamp."""
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(stamp_ns, NANOSECONDS)
    return message
