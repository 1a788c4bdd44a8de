"""A door before a WebSocket server of this computer: pages that were not named stay outside.

A browser lets any page connect to any WebSocket, also to one on this computer, and says in the
header `Origin` which page it is (RFC 6455, 10.2). The server of the Foxglove SDK does not look.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from contextlib import suppress
import threading

from evpinn_ros.common.errors import InputError, reason_of

LONGEST_HEAD = 16_384  # bytes of the request that opens a connection
HEAD_TIMEOUT_S = 10.0
MOST_CONNECTIONS = 32
PIECE = 65_536
END = b"\r\n\r\n"
REFUSAL = b"HTTP/1.1 403 Forbidden\r\nConnection: close\r\nContent-Length: 0" + END


def is_welcome(head: bytes, origins: Collection[str]) -> bool:
    """True if a request opens a WebSocket, from no page or from one of `origins`.

    `head` is that of an HTTP request, with its empty line; origins are as browsers write them,
    `https://app.foxglove.dev`.
    """
    found, upgrades = [], False
    for line in head.split(b"\r\n")[1:]:
        name, _, value = line.partition(b":")
        text = value.strip().decode("latin-1")
        if name.strip().lower() == b"origin":
            found.append(text)
        upgrades |= name.strip().lower() == b"upgrade" and text.lower() == "websocket"
    return upgrades and all(origin in origins for origin in found)


class OriginGate:
    """Passes connections on to a server, in a thread of its own.

    Attributes:
        port: on which it listens.
    """

    def __init__(
        self, host: str, port: int, server: tuple[str, int], origins: Collection[str]
    ) -> None:
        """Begin to listen.

        Args:
            host: name or address of the interface.
            port: 0 for any that is free.
            server: host and port that connections are passed on to.
            origins: of pages that may connect; what sends no origin is no page, and may.

        Raises:
            InputError: nothing can listen there.
        """
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
        self.port: int = self._door.sockets[0].getsockname()[1]
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
            with suppress(OSError, EOFError, asyncio.LimitOverrunError, asyncio.TimeoutError):
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
