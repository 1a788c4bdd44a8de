"""What rclpy needs to speak of a `Topic`: message classes, quality of service, endpoints."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
import importlib
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from evpinn_ros.nodes.topics import Qos, Topic


@cache
def message_class(type_name: str) -> Any:
    """The rclpy class of `package/msg/Type`."""
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def new_message(type_name: str, /, **fields: Any) -> Any:
    """A message for rclpy, as `messages.NewMessage` wants it."""
    return message_class(type_name)(**fields)


def qos_profile(qos: Qos) -> QoSProfile:
    """The rclpy form of a quality of service."""
    durability, reliability = DurabilityPolicy, ReliabilityPolicy
    return QoSProfile(
        depth=qos.depth,
        durability=durability.TRANSIENT_LOCAL if qos.transient_local else durability.VOLATILE,
        reliability=reliability.RELIABLE if qos.reliable else reliability.BEST_EFFORT,
    )


def advertise(node: Node, topic: Topic) -> Any:
    """A publisher; its quality of service can be overridden by parameters."""
    return node.create_publisher(
        message_class(topic.type_name),
        topic.name,
        qos_profile(topic.publisher_qos),
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
    )


def subscribe(
    node: Node, topic: Topic, callback: Callable[[Any], None], *, raw: bool = False
) -> Any:
    """A subscription likewise; with `raw` the callback gets the bytes of the message."""
    return node.create_subscription(
        message_class(topic.type_name),
        topic.name,
        callback,
        qos_profile(topic.subscriber_qos),
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        raw=raw,
    )
