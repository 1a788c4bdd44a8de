"""Serves messages to Foxglove over a WebSocket, as CDR bytes (extra `foxglove`).

A browser lets any page connect to any WebSocket, and says in `Origin` which page it is (RFC 6455,
10.2). The Foxglove SDK does not look, so a gate before it keeps out pages that were not named.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Mapping
from contextlib import suppress
from ipaddress import ip_address
import logging
from secrets import randbelow
import socket
import threading

from evpinn_ros.bags.types import typestore
from evpinn_ros.common.errors import InputError, reason_of
from evpinn_ros.common.optional import optional_imports

LOOPBACK, PORT = "127.0.0.1", 8765  # 8765 is where Foxglove looks
LAST_PORT = 65535
ORIGINS = ("https://app.foxglove.dev",)
"""Web pages that may connect."""
SEND_EVERY_NS = 20_000_000  # of the clock of a replay
LONGEST_HEAD = 16_384  # bytes of the request that opens a connection
HEAD_TIMEOUT_S = 10.0
MOST_CONNECTIONS = 32
PIECE = 65_536
END = b"\r\n\r\n"
REFUSAL = b"HTTP/1.1 403 Forbidden\r\nConnection: close\r\nContent-Length: 0" + END

# The SDK would show on the terminal, unchanged, what a client sends and nobody understands.
logging.getLogger("foxglove").setLevel(logging.CRITICAL)


class FoxgloveServer:
    """A server for any number of clients: a context manager, which stops it."""

    def __init__(
        self,
        host: str,
        port: int,
        topics: Mapping[str, str],
        *,
        replay: bool = False,
        origins: Collection[str] = (),
    ) -> None:
        """Begin to serve `topics` (types by name); port 0 is any that is free.

        With `replay` the clock is that of `send_time`; web pages of `origins` may connect beside
        `ORIGINS`. InputError: the extra is missing, or nothing can listen there.
        """
        if not 0 <= port <= LAST_PORT:
            raise InputError(f"port {port} is not in 0 to {LAST_PORT}")
        with optional_imports():
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
        self.address = f"ws://{shown}:{self._gate.port}"  # as Foxglove wants it, `ws://host:port`

    def __enter__(self) -> FoxgloveServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def send(self, topic: str, type_name: str, data: bytes, time_ns: int) -> None:
        """Give CDR bytes to subscribers without waiting; unknown topics are left out."""
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
    """An address of this computer that no web page can guess, where there are such."""
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


def is_welcome(head: bytes, origins: Collection[str]) -> bool:
    """True if the head of an HTTP request opens a WebSocket, from no page or one of `origins`."""
    asked_from, upgrades = [], False
    for line in head.split(b"\r\n")[1:]:
        name, _, value = line.partition(b":")
        text = value.strip().decode("latin-1")
        if name.strip().lower() == b"origin":
            asked_from.append(text)
        upgrades |= name.strip().lower() == b"upgrade" and text.lower() == "websocket"
    return upgrades and all(origin in origins for origin in asked_from)


class OriginGate:
    """Passes connections on to a server, in a thread of its own."""

    def __init__(
        self, host: str, port: int, server: tuple[str, int], origins: Collection[str]
    ) -> None:
        """Listen (port 0: any) and pass on to `server` what may connect; or InputError."""
        self._server, self._origins = server, frozenset(origins)
        self._open: set[asyncio.Task[None]] = set()
        self._loop = asyncio.new_event_loop()
        try:
            self._door = self._loop.run_until_complete(
                asyncio.start_server(self._come_in, host, port, limit=LONGEST_HEAD)
            )
        except (OSError, OverflowError, UnicodeError) as error:
            self._loop.close()
            where = f"cannot serve Foxglove at {host}:{port}"
            raise InputError(f"{where}: {reason_of(error)}") from error
        self.port: int = self._door.sockets[0].getsockname()[1]  # on which it listens
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close the door and every connection; a second call does nothing."""
        if self._loop.is_closed():
            return
        asyncio.run_coroutine_threadsafe(self._shut(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _shut(self) -> None:
        self._door.close()
        for task in self._open:
            task.cancel()
        await asyncio.gather(*self._open, return_exceptions=True)

    async def _come_in(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._open.add(task)
        try:
            if len(self._open) > MOST_CONNECTIONS:
                return  # no answer: each would hold a file open, of which a process has a thousand
            # A cancelled task would be a traceback of asyncio, before Python 3.12.
            ends = asyncio.LimitOverrunError, asyncio.TimeoutError, asyncio.CancelledError
            with suppress(OSError, EOFError, *ends):
                await self._pass_on(reader, writer)
        finally:
            self._open.discard(task)
            writer.close()

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await asyncio.wait_for(reader.readuntil(END), HEAD_TIMEOUT_S)
        if not is_welcome(head, self._origins):
            writer.write(REFUSAL)
            await writer.drain()
            return
        inner_reader, inner_writer = await asyncio.open_connection(*self._server)
        try:
            inner_writer.write(head)
            ways = [
                asyncio.ensure_future(_pump(reader, inner_writer)),
                asyncio.ensure_future(_pump(inner_reader, writer)),
            ]
            try:  # when one side has gone, so has the other
                await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
                await asyncio.gather(*ways, return_exceptions=True)
        finally:
            inner_writer.close()


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(PIECE):
        writer.write(data)
        await writer.drain()
