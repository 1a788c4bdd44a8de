"""Stand-in for `ros2 bag`, which is C++ and no wheel: takes what our launch files ask of it.

It really plays the messages of a bag, with /clock, and really records topics to a bag. An option
that it does not know is an error, so a launch file cannot ask for more unnoticed. In place of a
delay it waits until both nodes listen; a file that STAND_IN_END names ends the bag early.
"""

import argparse
from importlib.util import find_spec
import os
from pathlib import Path
import signal

from ament_index_python import get_package_share_directory
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rosbags.typesys import get_types_from_msg
from rosgraph_msgs.msg import Clock as ClockMessage

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import typestore
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.typed import PACKAGE as TYPED_PACKAGE
from evpinn_ros.topics import BATTERY, SPEED, topic_of

SECOND = 10**9


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("bag", choices=["bag"])
    verbs = parser.add_subparsers(dest="verb", required=True)
    play = verbs.add_parser("play")
    play.add_argument("path", type=Path)
    play.add_argument("--rate", type=float, default=1.0)
    play.add_argument("--delay", type=float, default=0.0)
    play.add_argument("--clock", type=float)
    play.add_argument("--remap", nargs="+", default=[])
    record = verbs.add_parser("record")
    record.add_argument("--storage", choices=["mcap"], required=True)
    record.add_argument("--output", type=Path, required=True)
    record.add_argument("--use-sim-time", action="store_true")
    for verb in (play, record):
        verb.add_argument("--topics", nargs="+", required=True)
    return parser.parse_args()


def play(node: rclpy.node.Node, asked: argparse.Namespace) -> None:
    moved = dict(pair.split(":=") for pair in asked.remap)
    outlets: dict[str, rclpy.publisher.Publisher] = {}
    ticks = node.create_publisher(ClockMessage, "/clock", 10) if asked.clock else None
    end = os.environ.get("STAND_IN_END")
    with BagReader(asked.path) as bag:
        for name in bag.topics:
            if name in asked.topics:
                kind = factory.message_class(topic_of(name).type_name)
                outlets[name] = node.create_publisher(kind, moved.get(name, name), 10)
        needed = [o for name, o in outlets.items() if name.endswith((SPEED.name, BATTERY.name))]
        while rclpy.ok() and min(outlet.get_subscription_count() for outlet in needed) < 2:
            rclpy.spin_once(node, timeout_sec=0.05)
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        first, begin, ticked = None, clock.now(), 0
        for record in bag.raw_records():
            now = record.log_time_ns
            first = now if first is None else first
            if (end is not None and Path(end).exists()) or not rclpy.ok():
                break
            clock.sleep_until(begin + Duration(nanoseconds=round((now - first) / asked.rate)))
            if ticks is not None and now - ticked > SECOND / asked.clock:
                message, ticked = ClockMessage(), now
                message.clock.sec, message.clock.nanosec = divmod(now, SECOND)
                ticks.publish(message)
            if record.topic in outlets:
                outlets[record.topic].publish(record.message)


def learn_types(package: str) -> None:
    """Let the writer define messages that are no wheels, from the files that were installed."""
    for path in Path(get_package_share_directory(package), "msg").glob("*.msg"):
        typestore().register(get_types_from_msg(path.read_text(), f"{package}/msg/{path.stem}"))


def record(node: rclpy.node.Node, asked: argparse.Namespace) -> None:
    print("recording", *asked.topics)
    if find_spec(TYPED_PACKAGE):
        learn_types(TYPED_PACKAGE)
    writer = BagWriter(asked.output, live=True, split=None)

    def listen(name: str, kind: str, qos: QoSProfile) -> None:
        def write(data: bytes) -> None:
            writer.write_raw(name, kind, data, node.get_clock().now().nanoseconds)

        node.create_subscription(factory.message_class(kind), name, write, qos, raw=True)

    waiting = {*asked.topics}
    for name in asked.topics:
        topic = topic_of(name)
        if topic is not None and factory.is_installed(topic.package):
            listen(name, topic.type_name, factory.qos_profile(topic.publisher_qos))
            waiting.remove(name)

    def look_around() -> None:  # for who publishes the others
        for name, (kind, *_) in node.get_topic_names_and_types():
            if name in waiting and factory.is_installed(kind.partition("/")[0]):
                listen(name, kind, qos_profile_sensor_data)
                waiting.remove(name)

    node.create_timer(0.1, look_around)
    try:
        rclpy.spin(node)
    except (ExternalShutdownException, RuntimeError):
        pass
    finally:
        writer.close()


def main() -> None:
    asked = options()
    signal.signal(signal.SIGINT, lambda *_: None)
    rclpy.init(args=[])
    node = rclpy.create_node(f"ros2_bag_{asked.verb}")
    if asked.verb == "play":
        try:
            play(node, asked)
        except RuntimeError:  # the shutdown came in the middle of a call into rclpy
            if rclpy.ok():
                raise
    else:
        record(node, asked)
    rclpy.try_shutdown()
    signal.signal(signal.SIGINT, signal.SIG_IGN)


main()
