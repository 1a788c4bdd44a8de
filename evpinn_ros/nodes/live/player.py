"""Plays a bag on its ROS topics for viewers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import time
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.stopping import stopped_by
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes.discovery import set_profile
from evpinn_ros.nodes.factory import is_installed, message_class, qos_profile
from evpinn_ros.nodes.live.data import NODES
from evpinn_ros.topics import QUEUE_DEPTH, Qos

LONGEST_PAUSE = 10.0  # s; longer pauses in the bag are shortened to it
POLL = 0.1  # s
DISCOVERY = 1.0  # s to wait for further subscribers after the first
KEPT = Qos(reliable=True, transient_local=True, depth=QUEUE_DEPTH)  # suits every subscriber


def play(reader: BagReader, rate: float, loop: bool, note: Callable[[str], None]) -> None:
    """Play once a viewer subscribes, and keep the last messages available until a signal.

    Raises:
        InputError: the bag has nothing to show, or running nodes would learn from it.
    """
    types = {
        name: info.type_name
        for name, info in reader.topics.items()
        if info.count and is_installed(info.type_name.partition("/")[0])
    }
    if not types:
        raise InputError(f"{reader.path}: holds no messages that can be shown")
    signals: list[int] = []
    set_profile()
    with stopped_by(lambda number, _: signals.append(number)):
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        try:
            player = _Player(types, signals)
            note(f"{reader.path}: waiting for a viewer of its topics; Ctrl-C ends")
            while not signals and not player.watched():
                time.sleep(POLL)
            time.sleep(DISCOVERY)
            while not signals:
                player.watched()
                player.play(reader, rate)
                if not loop:
                    break
            if not signals:
                note(f"{reader.path}: at its end")
            while not signals:
                time.sleep(POLL)
        finally:
            rclpy.try_shutdown()


class _Player(Node):
    def __init__(self, types: Mapping[str, str], signals: list[int]) -> None:
        super().__init__("bag_player", enable_rosout=False, start_parameter_services=False)
        self._signals = signals
        self._outlets: dict[str, Any] = {
            name: self.create_publisher(message_class(kind), name, qos_profile(KEPT))
            for name, kind in types.items()
        }

    def watched(self) -> bool:
        """Whether a viewer subscribes; InputError for a node that would learn from the bag."""
        subscribers = {
            info.node_name
            for name in self._outlets
            for info in self.get_subscriptions_info_by_topic(name)
        }
        if working := sorted(subscribers & set(NODES)):
            raise InputError(
                f"the node '{working[0]}' runs here and would take the bag for a drive: "
                "give the viewer and `evpinn view` another ROS_DOMAIN_ID"
            )
        return bool(subscribers)

    def play(self, reader: BagReader, rate: float) -> None:
        """Publish the recorded bytes of every message at its time."""
        due, before_ns = time.monotonic(), None
        for record in reader.raw_records(self._outlets):
            passed = 0.0 if before_ns is None else (record.log_time_ns - before_ns) / NANOSECONDS
            due += min(max(passed, 0.0), LONGEST_PAUSE) / rate
            before_ns = record.log_time_ns
            while not self._signals and (wait := due - time.monotonic()) > 0:
                time.sleep(min(wait, POLL))
            if self._signals:
                return
            self._outlets[record.topic].publish(record.message)
        if before_ns is None:
            raise InputError(f"{reader.path}: no message that can be shown")
