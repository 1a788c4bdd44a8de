"""Serves every topic of this package to Foxglove, as the bytes that came over the wire."""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from typing import Any

from evpinn_ros.nodes.base import GuardedNode
from evpinn_ros.nodes.diagnosis import Status, with_health
from evpinn_ros.nodes.factory import installed
from evpinn_ros.nodes.live.foxglove import FoxgloveServer, is_loopback
from evpinn_ros.topics import TOPICS, Topic
from evpinn_ros.topics.messages import Level


class FoxgloveNode(GuardedNode):
    """Passes messages on to a server, with the time of their arrival by the node's clock."""

    def __init__(self, host: str, port: int, origins: Collection[str] = (), **kwargs: Any) -> None:
        """Serve to Foxglove and to pages of `origins`; port 0: any; or InputError."""
        super().__init__("foxglove", **kwargs)
        self._count = 0
        installed_topics = installed(TOPICS)
        offered = {
            self.resolve_topic_name(topic.name): topic.type_name for topic in installed_topics
        }
        self._server = FoxgloveServer(host, port, offered, origins=origins)
        self._text, self._level = f"serving {self._server.address}", Level.OK
        if not is_loopback(host):
            self._text += " to the whole network: whoever reaches it can read along"
            self._level = Level.WARN
            self.get_logger().warning(self._text)
        else:
            self.get_logger().info(self._text)
        for topic in installed_topics:
            self.listen(topic, partial(self._send, topic), raw=True)

    def statuses(self) -> list[Status]:
        """Addresses served, and their load."""
        values = {"messages": self._count, "watched": self._server.watched}
        return [with_health(Status("server", self._level, self._text, values), self.health())]

    def close(self) -> None:
        """Stop the server."""
        self._server.close()

    def _send(self, topic: Topic, data: bytes) -> None:
        name = self.resolve_topic_name(topic.name)
        self._server.send(name, topic.type_name, data, self.now_ns())
        self._count += 1
