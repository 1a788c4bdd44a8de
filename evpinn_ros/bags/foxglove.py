"""Serves messages to Foxglove over a WebSocket, as the CDR bytes they are.

Wants the extra `foxglove`. Topics and types are those of a bag, so one layout fits both.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from ipaddress import ip_address
from secrets import randbelow
import socket

from evpinn_ros.bags.origin_gate import OriginGate
from evpinn_ros.bags.types import typestore
from evpinn_ros.common.errors import InputError, extra_needed

LOOPBACK, PORT = "127.0.0.1", 8765  # 8765 is where Foxglove looks
LAST_PORT = 65535
ORIGINS = ("https://app.foxglove.dev",)
"""Web pages that may connect."""
SEND_EVERY_NS = 20_000_000  # of the clock of a replay


class FoxgloveServer:
    """A server for any number of clients: a context manager, which stops it.

    Attributes:
        address: as Foxglove wants it, `ws://host:port`.
    """

    def __init__(
        self,
        host: str,
        port: int,
        topics: Mapping[str, str],
        *,
        replay: bool = False,
        origins: Collection[str] = (),
    ) -> None:
        """Begin to serve.

        Args:
            host: name or address of the interface to listen on.
            port: 0 for any that is free.
            topics: types by full name, all of ROS 2 Jazzy.
            replay: whether `send_time` gives the clock; else it is the computer's.
            origins: of web pages that may connect beside `ORIGINS`.

        Raises:
            InputError: the extra is not installed, or nothing can listen there.
        """
        if not 0 <= port <= LAST_PORT:
            raise InputError(f"port {port} is not in 0 to {LAST_PORT}")
        with extra_needed("Foxglove wants an extra", "foxglove"):
            import foxglove
            from foxglove.websocket import Capability
        self._context = foxglove.Context()  # channels close with it
        # Before the server: what a client subscribes to while it is being offered may be lost.
        self._channels = {
            (topic, type_name): foxglove.Channel(
                topic,
                schema=foxglove.Schema(
                    name=type_name, encoding="ros2msg", data=_definition(type_name)
                ),
                message_encoding="cdr",
                context=self._context,
            )
            for topic, type_name in topics.items()
        }
        self._sent_ns = -SEND_EVERY_NS
        inside = _inside()
        self._server = foxglove.start_server(
            name="evpinn",
            host=inside,
            port=0,
            context=self._context,
            capabilities=[Capability.Time] if replay else [],
        )
        try:
            self._gate = OriginGate(host, port, (inside, self._server.port), {*ORIGINS, *origins})
        except InputError:
            self._server.stop()
            raise
        shown = f"[{host}]" if ":" in host else host
        self.address = f"ws://{shown}:{self._gate.port}"

    def __enter__(self) -> FoxgloveServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def send(self, topic: str, type_name: str, data: bytes, time_ns: int) -> None:
        """Give one message, as CDR bytes, to those who subscribed; never waits for them.

        What is not among the topics, or among them with another type, is left out. A time before
        1970, which a bag may hold and Foxglove does not know, is shown as 1970.
        """
        channel = self._channels.get((topic, type_name))
        if channel is not None:
            channel.log(data, log_time=max(time_ns, 0))

    def send_time(self, time_ns: int) -> None:
        """Set the clock of all clients; sent often enough for a smooth picture."""
        if not 0 <= time_ns - self._sent_ns < SEND_EVERY_NS:
            self._server.broadcast_time(max(time_ns, 0))
            self._sent_ns = time_ns

    def start_over(self) -> None:
        """Let all clients forget what they have, for time begins anew."""
        self._server.clear_session()

    @property
    def watched(self) -> bool:
        """True if anybody has subscribed to anything."""
        return any(channel.has_sinks() for channel in self._channels.values())

    def close(self) -> None:
        """Stop; clients see that the connection ended."""
        self._gate.close()
        self._server.stop()


def _inside() -> str:
    """An address of this computer alone that no web page can guess, where there are such.

    The whole of 127/8 is this computer on Linux; elsewhere there is 127.0.0.1, and a port of
    thousands has to do.
    """
    host = f"127.{1 + randbelow(254)}.{randbelow(256)}.{1 + randbelow(254)}"
    with socket.socket() as trial:
        try:
            trial.bind((host, 0))
        except OSError:
            return LOOPBACK
    return host


def _definition(type_name: str) -> bytes:
    definition, _ = typestore().generate_msgdef(type_name, ros_version=2)
    return str(definition).encode()


def is_loopback(host: str) -> bool:
    """True if only this machine can reach what listens there."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
