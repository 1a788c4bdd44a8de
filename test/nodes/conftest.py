"""A bench for nodes: the far end of every topic, in one executor with the nodes under test."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from functools import partial
import os
from pathlib import Path
import subprocess
import sys
import time
from typing import Any
from unittest import mock

import pytest
from rcl_interfaces.msg import Log
import rclpy
from rclpy.serialization import deserialize_message, serialize_message

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import decode
from evpinn_ros.core.signals.readings import BatteryReading, Reading, SpeedReading
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.base import GuardedNode
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.parameters import overrides
from evpinn_ros.nodes.processes import own_network
from evpinn_ros.nodes.running import new_executor
from evpinn_ros.topics import (
    BATTERY,
    DIAGNOSTICS,
    NAMESPACE,
    POWER_MEASURED,
    POWER_SMOOTHED,
    SPEED,
    Topic,
    topic_of,
)
from evpinn_ros.topics.messages import Level
from evpinn_ros.topics.readings import READING_TOPICS, reading_message, to_reading
from test.nodes.processes import add_messages
from test.waiting import HANG_S, wait_until

pytestmark = pytest.mark.ros


# All of this is read when ROS starts or the first message class is loaded, later than here.
own_network(range(2, 82))
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")

ROOT = Path(__file__).resolve().parents[2]
VEHICLE = "tesla_model_3_lr"
POWERS = (POWER_MEASURED, POWER_SMOOTHED)  # of which energy is counted
SPIN = 0.02  # s


class Bench:
    """Sends and hears; `pump` lets the nodes work until something is so."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("bench", namespace=NAMESPACE)
        self.executor = new_executor()
        self.executor.add_node(self.node)
        self.nodes: list[GuardedNode] = []
        self.heard: dict[Topic, list[Any]] = defaultdict(list)
        self.faulty: set[GuardedNode] = set()  # those whose faults a test made on purpose
        self._inputs: dict[GuardedNode, dict[str, Any]] = {}  # subscriptions by topic
        self._spun = time.monotonic()
        self._publishers: dict[Topic, Any] = {}
        self._clients: dict[str, Any] = {}
        self._numbers: Counter[tuple[GuardedNode, Topic]] = Counter()  # of messages delivered

    def start(
        self, make: Callable[..., GuardedNode], namespace: str = NAMESPACE, /, **parameters: Any
    ) -> Any:
        """Make a node under test; drives come faster than real time, so updates are awaited."""
        values = {"vehicle": VEHICLE, **parameters}
        if make is EstimatorNode:
            values.setdefault("wait_for_update", True)
        node = make(namespace=namespace, parameter_overrides=overrides(values))
        self.nodes.append(node)
        named = {subscription.topic_name: subscription for subscription in node.subscriptions}
        self._inputs[node] = {name: inlet for name, inlet in named.items() if topic_of(name)}
        self.executor.add_node(node)
        return node

    def stop(self, node: GuardedNode) -> None:
        """End a node as its executable does at SIGINT."""
        self.executor.remove_node(node)
        self.nodes.remove(node)
        node.close()
        assert bool(node.health().faults) == (node in self.faulty)
        node.destroy_node()

    def await_reports(self, node: GuardedNode, count: int) -> None:
        """Let a node report, and log what is new, this often: once a second."""
        last = node.published[DIAGNOSTICS] + count
        self.pump(lambda: node.published[DIAGNOSTICS] >= last)

    def listen(self, *topics: Topic) -> None:
        """Hear topics, and wait until their publishers are found."""
        listeners = [factory.subscribe(self.node, t, self.heard[t].append) for t in topics]
        self.pump(lambda: all(self.node.count_publishers(s.topic_name) for s in listeners))

    def hear(self, topic: Topic, namespace: str = NAMESPACE) -> list[Any]:
        """All that will come on a topic under a namespace, whoever publishes it."""
        heard: list[Any] = []
        kind, qos = factory.message_class(topic.type_name), topic.subscriber_qos
        name, profile = topic.under(namespace), factory.qos_profile(qos)
        self.node.create_subscription(kind, name, heard.append, profile)
        return heard

    def log_lines(self) -> list[str]:
        """All lines that nodes will log."""
        lines: list[str] = []
        self.node.create_subscription(Log, "/rosout", lambda log: lines.append(log.msg), 1000)
        return lines

    def publisher(self, topic: Topic) -> Any:
        """The publisher of a topic, once somebody listens to it."""
        if topic not in self._publishers:
            publisher = self._publishers[topic] = factory.advertise(self.node, topic)
            self.pump(lambda: publisher.get_subscription_count() > 0)
        return self._publishers[topic]

    def send(self, topic: Topic, message: Any) -> None:
        """Publish a message; `pump` until what it leads to is there."""
        self.publisher(topic).publish(message)

    def post(self, node: GuardedNode, topic: Topic, message: Any) -> None:
        """One message over DDS: return when the node has dealt with it."""
        count = node.received[topic]
        self.send(topic, message)
        self.pump(lambda: node.received[topic] > count)

    def deliver(self, node: GuardedNode, topic: Topic, message: Any) -> None:
        """Hand a message to a node as its executor would: nothing is on the way, or gets lost."""
        subscription = self._inputs[node][topic.under()]
        self._numbers[node, topic] += 1
        info = {"publication_sequence_number": self._numbers[node, topic]}
        data = serialize_message(message)
        message = data if subscription.raw else deserialize_message(data, subscription.msg_type)
        subscription.callback(message, info)
        self._take(self.node)  # before what it leads to fills a queue

    def read(self, node: GuardedNode, *readings: Reading) -> None:
        """Deliver readings, each as the message of its own topic."""
        for reading in readings:
            message = reading_message(factory.new_message, reading)
            self.deliver(node, READING_TOPICS[type(reading)], message)

    def drive(self, messages: Iterable[tuple[Topic, Any]]) -> None:
        """Deliver each message to all who listen, and what that leads to, before the next."""
        for topic, message in messages:
            for node in self.nodes:
                if topic.under() in self._inputs[node]:
                    self.deliver(node, topic, message)
            self.pump(self._powers_have_arrived)

    def _powers_have_arrived(self) -> bool:
        meters = [node for node in self.nodes if isinstance(node, EnergyNode)]
        sent = {power: sum(node.published[power] for node in self.nodes) for power in POWERS}
        return all(node.received[power] == sent[power] for node in meters for power in POWERS)

    def call(self, kind: Any, name: str, **request: Any) -> Any:
        """Call a service of a node under test."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
            self.pump(self._clients[name].service_is_ready)
        future = self._clients[name].call_async(kind.Request(**request))
        self.pump(future.done)
        return future.result()

    def ask(self, kind: Any, name: str, **request: Any) -> Any:
        """Call a service of another process, again after 2 s without an answer.

        An answer that is sent before DDS has matched both sides is lost, and for seconds a
        server that was killed seems alive.
        """
        client, answers = self.node.create_client(kind, name), []

        def call() -> None:
            asked, soon = client.call_async(kind.Request(**request)), time.monotonic() + 2.0
            asked.add_done_callback(lambda answered: answers.append(answered.result()))
            self.pump(lambda: answers or time.monotonic() > soon)

        wait_until(lambda: answers, meanwhile=call)
        self.node.destroy_client(client)
        return answers[0]

    def diagnosis(self, node: GuardedNode) -> dict[str, Any]:
        """Diagnostics of a node now: (level, text, values) by the name of the part."""
        reported: list[tuple[Topic, Any]] = []
        publish = node.publish

        def take(messages: Iterable[tuple[Topic, Any]]) -> None:
            """Keep the report; what a thread of the node publishes meanwhile goes its way."""
            pairs = list(messages)
            reported.extend(pair for pair in pairs if pair[0] is DIAGNOSTICS)
            publish(pair for pair in pairs if pair[0] is not DIAGNOSTICS)

        with mock.patch.object(node, "publish", take):
            node.report()
        return {
            status.name.rpartition(" ")[2]: (
                Level(int.from_bytes(status.level, "little")),
                status.message,
                {pair.key: pair.value for pair in status.values},
            )
            for _, message in reported
            for status in message.status
        }

    def pump(self, condition: Callable[[], object], timeout: float = HANG_S) -> None:
        """Let all nodes work until something is so."""
        graph = self.node.get_node_names_and_namespaces
        wait_until(condition, timeout, meanwhile=self._work, report=graph)

    def _work(self) -> None:
        if not self._take(self.node, *self.nodes) or time.monotonic() > self._spun + SPIN:
            self.executor.spin_once(timeout_sec=SPIN)
            self._spun = time.monotonic()

    def _take(self, *nodes: Any) -> bool:
        """Take all that has come: an executor makes its wait set anew for each message."""
        taken_any = False
        for node in nodes:
            bench = node is self.node
            for inlet in node.subscriptions if bench else self._inputs[node].values():
                while (taken := inlet.handle.take_message(inlet.msg_type, inlet.raw)) is not None:
                    taken_any = True
                    inlet.callback(*(taken[:1] if bench else taken))
        return taken_any

    def settle(self) -> None:
        """Let every listener hear all that the nodes under test have to publish."""
        for node in self.nodes:
            if isinstance(node, EnergyNode):
                node.count()
        sent = sum((node.published for node in self.nodes), Counter())
        topics = self.heard.keys() - {DIAGNOSTICS}  # a report of the timer may come in between
        self.pump(lambda: all(len(self.heard[topic]) == sent[topic] for topic in topics))

    def close(self) -> None:
        for node in [*self.nodes]:
            self.stop(node)
        self.executor.shutdown()
        self.node.destroy_node()


@pytest.fixture
def can_bus() -> Iterator[tuple[Any, dict[str, Any]]]:
    """A bus that crosses processes, and the parameters by which a bridge joins it."""
    # Here, for python-can takes long to import and most tests need none of it.
    import can

    # The one kind of bus of python-can that crosses processes on any machine.
    interface, group = "udp_multicast", "239.74.163.5"
    options = {"port": 20_000 + os.getpid() % 20_000, "hop_limit": 0}
    try:
        bus = can.Bus(group, interface=interface, **options)
    except (OSError, can.CanError) as error:
        pytest.skip(f"no multicast here: {error}")
    text = " ".join(f"{name}={value}" for name, value in options.items())
    parameters = {"interface": interface, "channel": group, "bitrate": 0, "bus_options": text}
    with bus:
        yield bus, parameters


@pytest.fixture
def bench() -> Iterator[Bench]:
    """Nodes in this process."""
    rclpy.init()
    bench = Bench()
    try:
        yield bench
        bench.close()
    finally:
        rclpy.try_shutdown()


@pytest.fixture
def run_with_messages() -> Callable[[str], None]:
    """Runs the tests of a file beside this where messages that are no wheels are installed."""
    environment = dict(os.environ)
    if not add_messages(environment):
        pytest.skip("the messages are not built: `make test` does it where a compiler is")

    def run(file: str) -> None:
        command = (sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider")
        completed = subprocess.run(
            [*command, Path(__file__).with_name(file)],
            cwd=ROOT, env=environment, capture_output=True, text=True, timeout=250,
        )  # fmt: skip
        assert completed.returncode == 0, completed.stdout + completed.stderr

    return run


def messages(name: str, seconds: float) -> Iterator[tuple[Topic, Any, Any]]:
    inputs, start = {topic.under(): topic for topic in (SPEED, BATTERY)}, None
    with BagReader(ROOT / "bags" / name) as bag:
        for record in bag.raw_records(inputs):
            start = start or record.log_time_ns
            if record.log_time_ns - start > seconds * 1e9:
                return
            data, kind = record.message, factory.message_class(record.type_name)
            decoded = decode(record.type_name, data)
            yield inputs[record.topic], decoded, deserialize_message(data, kind)


@pytest.fixture(scope="session")
def bundled() -> Callable[[str, float], Iterator[tuple[Topic, Any, Any]]]:
    """The first seconds of a bundled bag: topic, message of rosbags, the same of rclpy."""
    return messages


@pytest.fixture
def can_log(tmp_path: Path) -> Callable[..., Path]:
    """Writes the CAN log of a Model 3 on the first seconds of a bundled drive."""
    from evpinn_ros.can.encoder import Encoder
    from evpinn_ros.can.logs import write_log
    from evpinn_ros.can.profile import load_profile

    def write(bag: str, seconds: float) -> Path:
        encoder, log = Encoder(load_profile("tesla_model_3")), tmp_path / f"{bag}.log"
        encode = {SpeedReading: encoder.speed, BatteryReading: encoder.battery}
        readings = (to_reading(topic.type_name, m) for topic, m, _ in messages(bag, seconds))
        write_log(log, [encode[type(reading)](reading) for reading in readings])
        return log

    return write


@pytest.fixture(scope="session")
def urban() -> Callable[[float], Iterator[tuple[Topic, Any, Any]]]:
    """The first seconds of the bag `urban`, as `bundled` gives them."""
    return partial(messages, "urban")
