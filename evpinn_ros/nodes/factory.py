"""Makes message classes, QoS profiles and endpoints of rclpy for a `Topic`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
import importlib
from importlib.util import find_spec
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
    qos_policy_name_from_kind,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message

from evpinn_ros.common.errors import InputError
from evpinn_ros.topics import Qos, Topic
from evpinn_ros.topics.messages import BadMessage

OVERRIDABLE = tuple(
    getattr(QoSPolicyKind, name) for name in ("HISTORY", "DEPTH", "RELIABILITY", "DURABILITY")
)
"""Policies that parameters may override: those of `Qos`, and rclpy's default three."""


@cache
def is_installed(package: str) -> bool:
    """Whether a message package is built and installed; its source folder alone is not."""
    spec = find_spec(package)
    return spec is not None and spec.origin is not None


def installed(topics: Iterable[Topic]) -> list[Topic]:
    """The topics whose message packages are installed; those of Autoware may be missing."""
    return [topic for topic in topics if is_installed(topic.package)]


@cache
def message_class(type_name: str) -> Any:
    """The rclpy class of `package/msg/Type` or `package/srv/Type`."""
    package, kind, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), name)


def new_message(type_name: str, /, **fields: Any) -> Any:
    """An rclpy message with these fields; a `messages.NewMessage`."""
    return message_class(type_name)(**fields)


def decode(type_name: str, data: bytes) -> Any:
    """The message at the start of CDR bytes; BadMessage if they are damaged."""
    try:
        return deserialize_message(data, message_class(type_name))
    except RuntimeError as error:
        raise BadMessage("damaged") from error


def qos_profile(qos: Qos) -> QoSProfile:
    """The rclpy form of a quality of service."""
    durability, reliability = DurabilityPolicy, ReliabilityPolicy
    return QoSProfile(
        depth=qos.depth,
        durability=durability.TRANSIENT_LOCAL if qos.transient_local else durability.VOLATILE,
        reliability=reliability.RELIABLE if qos.reliable else reliability.BEST_EFFORT,
    )


def advertise(node: Node, topic: Topic, on_mismatch: Callable[[str], None] | None = None) -> Any:
    """A publisher with QoS overrides; `on_mismatch` gets a policy that a subscriber refuses."""
    events = PublisherEventCallbacks(**_mismatch(on_mismatch))
    return node.create_publisher(
        message_class(topic.type_name),
        topic.name,
        qos_profile(topic.publisher_qos),
        qos_overriding_options=_overriding(node, topic, "publisher"),
        event_callbacks=events,
    )


def subscribe(
    node: Node,
    topic: Topic,
    callback: Callable[..., None],
    *,
    raw: bool = False,
    on_mismatch: Callable[[str], None] | None = None,
) -> Any:
    """A subscription with the topic's QoS; a callback of two arguments gets rclpy's info too."""
    events = SubscriptionEventCallbacks(**_mismatch(on_mismatch))
    return node.create_subscription(
        message_class(topic.type_name),
        topic.name,
        callback,
        qos_profile(topic.subscriber_qos),
        qos_overriding_options=_overriding(node, topic, "subscription"),
        event_callbacks=events,
        raw=raw,
    )


def _overriding(node: Node, topic: Topic, end: str) -> QoSOverridingOptions | None:
    """Options that declare the QoS parameters of an endpoint; None if none of them was given."""
    start = f"qos_overrides.{node.resolve_topic_name(topic.name)}.{end}."
    given = any(name.startswith(start) for name in node._parameter_overrides)
    return QoSOverridingOptions(OVERRIDABLE) if given else None


def refuse_unknown_overrides(node: Node) -> None:
    """Raise InputError for an override of an endpoint of this node with an unknown policy."""
    given = {name for name in node._parameter_overrides if name.startswith("qos_overrides.")}
    for name in sorted(given):
        endpoint, _, policy = name.rpartition(".")
        if node.has_parameter(f"{endpoint}.depth") and not node.has_parameter(name):
            policies = ", ".join(kind.name.lower() for kind in OVERRIDABLE)
            raise InputError(f"{name}: '{policy}' cannot be overridden; known are {policies}")


def _mismatch(tell: Callable[[str], None] | None) -> dict[str, Any]:
    """Event callbacks for mismatched QoS alone: those for wrong types double every wait."""
    if tell is None:
        return {}

    def incompatible_qos(event: Any) -> None:
        tell(qos_policy_name_from_kind(event.last_policy_kind).lower())

    return {"incompatible_qos": incompatible_qos, "use_default_callbacks": False}
