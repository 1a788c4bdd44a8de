"""Bond of a managed node with Nav2's lifecycle manager, where the package `bond` is installed.

The manager listens for a heartbeat of each node that it has activated, on the topic `bond` beside
it; where that stops without a word, it takes the other nodes down.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from uuid import uuid4

from rclpy.node import Node

from evpinn_ros.nodes.factory import is_installed, message_class

PACKAGE, STATUS_TYPE, TOPIC = "bond", "bond/msg/Status", "bond"
PERIOD, TIMEOUT = 0.1, 4.0  # s, as Nav2's own nodes have them
DEPTH = 100  # statuses of all nodes of a manager


class Bond:
    """One end of the bond that has the name of its node; the manager holds the other."""

    def __init__(self, node: Node, every: Callable[[float, Callable[[], object]], object]) -> None:
        """Make publisher, subscription and timer, which stay silent until `begin`.

        Args:
            node: whose name the bond has.
            every: calls back with a period in s.
        """
        self._node, self._kind = node, message_class(STATUS_TYPE)
        # Every identity that this end had: what it said last may come back after it began anew.
        self._own: list[str] = []
        self._alive = False
        self.publisher = node.create_publisher(self._kind, TOPIC, DEPTH)
        self.subscription = node.create_subscription(self._kind, TOPIC, self._take, DEPTH)
        every(PERIOD, self._beat)

    def begin(self) -> None:
        """Be alive, as a new one: the manager forms a bond anew at each activation."""
        self._own.append(str(uuid4()))
        self._alive = True

    def end(self) -> None:
        """Say that this end goes, so that the manager misses no heartbeat."""
        if self._alive:
            self._alive = False
            self._say(active=False)

    def _beat(self) -> None:
        if self._alive:
            self._say(active=True)

    def _take(self, message: Any) -> None:
        """Go with the other end, when it goes first."""
        ours = message.id == self._node.get_name() and message.instance_id not in self._own
        if ours and not message.active:
            self.end()

    def _say(self, *, active: bool) -> None:
        message = self._kind(id=self._node.get_name(), instance_id=self._own[-1], active=active)
        message.heartbeat_period, message.heartbeat_timeout = PERIOD, TIMEOUT
        message.header.stamp = self._node.get_clock().now().to_msg()
        self.publisher.publish(message)


def bond_of(node: Node, every: Callable[[float, Callable[[], object]], object]) -> Bond | None:
    """The bond of a node; None without its messages."""
    return Bond(node, every) if is_installed(PACKAGE) else None
