"""Foxglove's side of the wire: a real server, a real WebSocket, of a bag and of live nodes.

The protocol: github.com/foxglove/ws-protocol, docs/spec.md.
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import islice
import json
from pathlib import Path
import socket
import struct
import sys
from typing import Any, NamedTuple

import pytest

from evpinn_ros import topics
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import decode, new_message, typestore
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.cli.view import view
from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes.factory import installed
from evpinn_ros.nodes.live.data import NODES
from evpinn_ros.nodes.live.foxglove import LOOPBACK, MOST_CONNECTIONS, FoxgloveServer, is_loopback
from evpinn_ros.nodes.live.foxglove_node import FoxgloveNode
from evpinn_ros.topics.messages import Level, scalar
from test.conftest import ROOT
from test.nodes.processes import EVPINN, await_line, started, stopped
from test.waiting import HANG_S, wait_until

pytest.importorskip("foxglove", reason="the extra `foxglove` is not installed")
websockets = pytest.importorskip("websockets.sync.client", reason="no WebSocket client")
InvalidStatus = pytest.importorskip("websockets.exceptions").InvalidStatus

URBAN = ROOT / "bags" / "urban"
SECOND = 10**9

MESSAGE, TIME = 1, 2  # opcodes of binary frames from the server


class Received(NamedTuple):
    """A message of a subscribed channel."""

    topic: str
    time_ns: int
    data: bytes


class Client:
    """One connection.

    Attributes:
        info: what the server says of itself.
        channels: offered so far, by topic.
        times: of the server's clock so far, ns.
        sessions: ids of all sessions so far.
    """

    def __init__(self, connection: Any) -> None:
        self._connection = connection
        self._subscribed: dict[int, str] = {}
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.times: list[int] = []
        self.sessions: list[str] = []

    def await_channels(self, *topics: str) -> None:
        while not self.info or not set(topics) <= self.channels.keys():
            self._take(self._connection.recv(timeout=HANG_S))

    def subscribe(self, *topics: str) -> None:
        self.await_channels(*topics)
        wanted = [{"id": n, "channelId": self.channels[t]["id"]} for n, t in enumerate(topics)]
        self._subscribed = dict(enumerate(topics))
        self._connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def messages(self) -> Iterator[Received]:
        while True:
            received = self._take(self._connection.recv(timeout=HANG_S))
            if received is not None:
                yield received

    def _take(self, frame: str | bytes) -> Received | None:
        if isinstance(frame, str):
            said = json.loads(frame)
            if said["op"] == "serverInfo":
                self.info = said
                self.sessions.append(said["sessionId"])
            elif said["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in said["channels"]}
        elif frame[0] == MESSAGE:
            subscription, time_ns = struct.unpack_from("<IQ", frame, 1)
            return Received(self._subscribed[subscription], time_ns, frame[13:])
        elif frame[0] == TIME:
            self.times.append(struct.unpack_from("<Q", frame, 1)[0])
        return None


@contextmanager
def connected(address: str) -> Iterator[Client]:
    with websockets.connect(address, subprotocols=["foxglove.sdk.v1"]) as connection:
        yield Client(connection)


@contextmanager
def evpinn(*arguments: object) -> Iterator[str]:
    """The address of a command that serves; it must end well at Ctrl-C."""
    with started(*EVPINN, *arguments) as running:
        yield await_line(running, r"ws://[\d.]+:\d+")
        stopped(running)


def test_a_bag_comes_as_it_was_recorded():
    with BagReader(URBAN) as bag:
        recorded = list(islice(bag.raw_records(["/ev/vehicle/speed"]), 20))
    with evpinn("view", URBAN, "--port", 0, "--rate", 20) as address, connected(address) as app:
        app.subscribe("/ev/vehicle/speed")
        received = list(islice(app.messages(), 20))
    assert [(m.topic, m.time_ns, m.data) for m in received] == [
        (r.topic, r.log_time_ns, r.message) for r in recorded
    ]
    assert app.info["name"] == "evpinn" and "time" in app.info["capabilities"]
    assert app.times[0] <= received[0].time_ns and app.times == sorted(app.times)


def test_channels_say_how_to_read_them():
    offered = {"/ev/vehicle/speed": topics.SPEED_TYPE}
    with FoxgloveServer(LOOPBACK, 0, offered) as server, connected(server.address) as app:
        app.await_channels("/ev/vehicle/speed")
    channel = app.channels["/ev/vehicle/speed"]
    definition, _ = typestore().generate_msgdef(topics.SPEED_TYPE, ros_version=2)
    assert channel["encoding"] == "cdr" and channel["schemaEncoding"] == "ros2msg"
    assert channel["schemaName"] == topics.SPEED_TYPE and channel["schema"] == definition
    assert "time" not in app.info["capabilities"]  # what is live comes now


def test_a_bag_in_a_loop_starts_over_as_a_new_session(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for second in (0, 1, 100_000):  # a night in between takes ten seconds
            bag.write("/ev/estimate/eta", scalar(new_message, 1.0), (second + 9) * SECOND)
    options = ("--port", 0, "--rate", 100, "--loop")
    with evpinn("view", tmp_path / "bag", *options) as address, connected(address) as app:
        app.subscribe("/ev/estimate/eta")
        stamps = [message.time_ns // SECOND for message in islice(app.messages(), 6)]
    assert stamps == 2 * [9, 10, 100_009]
    assert len(set(app.sessions)) >= 2


def test_live_topics_come_as_they_are_published(bench, urban):
    node = bench.start(lambda **rest: FoxgloveNode(LOOPBACK, 0, namespace=rest["namespace"]))
    level, text, values = bench.diagnosis(node)["server"]
    assert level is Level.OK and values["watched"] == "False"
    with connected(text.removeprefix("serving ")) as app:
        app.subscribe("/ev/vehicle/speed", "/diagnostics")
        assert {t.under() for t in installed(topics.TOPICS)} <= app.channels.keys()
        bench.pump(lambda: bench.diagnosis(node)["server"][2]["watched"] == "True")
        _, sent, message = next(sample for sample in urban(1.0) if sample[0] == topics.SPEED)
        bench.deliver(node, topics.SPEED, message)
        received = next(m for m in app.messages() if m.topic == "/ev/vehicle/speed")
    assert decode(topics.SPEED_TYPE, received.data).twist.twist.linear == sent.twist.twist.linear
    assert received.time_ns == pytest.approx(node.now_ns(), abs=60 * SECOND)


def test_run_serves_what_its_nodes_say():
    options = ("--vehicle", "tesla_model_3_lr", "--foxglove", "--foxglove-port", 0)
    with evpinn("run", *options) as address, connected(address) as app:
        app.subscribe("/diagnostics")
        message = decode(topics.DIAGNOSTICS_TYPE, next(app.messages()).data)
    assert address.startswith("ws://127.0.0.1:")
    assert message.status[0].name.partition(":")[0].removeprefix("/ev/") in NODES


def test_beyond_loopback_it_warns(bench):
    node = bench.start(lambda **rest: FoxgloveNode("0.0.0.0", 0, namespace=rest["namespace"]))
    level, text, _ = bench.diagnosis(node)["server"]
    assert level is Level.WARN and "whole network" in text
    assert is_loopback("::1") and is_loopback("localhost") and not is_loopback("192.168.1.2")
    assert not is_loopback("my-laptop.example")


def test_a_port_in_use_and_a_bag_without_messages_are_refused(tmp_path):
    with FoxgloveServer(LOOPBACK, 0, {}) as server:
        port = int(server.address.rpartition(":")[2])
        with pytest.raises(InputError, match=rf"127\.0\.0\.1:{port}: .*in use"):
            view(URBAN, port=port)
    with BagWriter(tmp_path / "bag"):
        pass
    with pytest.raises(InputError, match="holds no messages"):
        view(tmp_path / "bag", port=0)


@pytest.mark.parametrize(
    ("origin", "welcome"),
    [
        (None, True),  # a program
        ("https://app.foxglove.dev", True),
        ("http://localhost:8080", True),  # named below
        ("https://evil.example", False),
        ("https://app.foxglove.dev.evil.example", False),
        ("http://app.foxglove.dev", False),
        ("null", False),
        ("file://", False),
    ],
)
def test_a_web_page_reads_only_where_it_was_named(origin, welcome):
    offered = {"/a": "std_msgs/msg/Float64"}
    with FoxgloveServer(LOOPBACK, 0, offered, origins=["http://localhost:8080"]) as server:

        def connect():
            return websockets.connect(
                server.address, origin=origin, subprotocols=["foxglove.sdk.v1"]
            )

        if not welcome:
            with pytest.raises(InvalidStatus, match="403"):
                connect()
            return
        with connect() as connection:
            Client(connection).await_channels("/a")


@pytest.mark.parametrize(
    "request_bytes",
    [
        b"GET / HTTP/1.1\r\nHost: a\r\n\r\n",  # no WebSocket
        b"GET / HTTP/1.1\r\nUpgrade: websocket\r\nORIGIN : https://evil.example\r\n\r\n",
        b"GET / HTTP/1.1\r\nUpgrade: websocket\r\nOrigin: https://app.foxglove.dev\r\n"
        b"Origin: https://evil.example\r\n\r\n",
        b"x" * 100_000,
    ],
)
def test_whatever_comes_to_the_door_it_stays_shut(request_bytes):
    with FoxgloveServer(LOOPBACK, 0, {}) as server:
        port = int(server.address.rpartition(":")[2])
        with socket.create_connection((LOOPBACK, port), timeout=HANG_S) as guest:
            guest.sendall(request_bytes)
            answer = b""
            with suppress(ConnectionResetError):
                while part := guest.recv(1000):
                    answer += part
        assert answer == b"" or answer.startswith(b"HTTP/1.1 403 ")


def test_whatever_a_viewer_sends_shows_nothing_and_others_are_served(caplog):
    """What nobody understands would come to the terminal as it is, with its escapes."""
    nonsense = (None, -1, 2**64, "\x1b[31m", [], {}, [{"id": 1, "channelId": "\x1b[2J\n"}])
    names = ("subscribe", "unsubscribe", "advertise", "setParameters", "fetchAsset", "\x1b[2J\n")
    keys = ("subscriptions", "channels", "parameters", "uri")
    frames = [json.dumps(dict.fromkeys(keys, n) | {"op": op}) for op in names for n in nonsense]
    offered = {"/a": "std_msgs/msg/Float64"}
    with FoxgloveServer(LOOPBACK, 0, offered) as server, ExitStack() as stack:
        for frame in (*frames, "[" * 5000, b"\0", bytes(range(256))):
            with websockets.connect(server.address, subprotocols=["foxglove.sdk.v1"]) as guest:
                guest.send(frame)
        app = stack.enter_context(connected(server.address))
        app.subscribe("/a")
        wait_until(lambda: server.watched)
        server.send("/a", offered["/a"], bytes(12), 5)
        assert next(app.messages()).time_ns == 5
        server.close()  # with a viewer, as Ctrl-C does
    assert caplog.messages == []


@pytest.mark.skipif(sys.platform != "linux", reason="127/8 is this computer on Linux alone")
def test_no_page_can_guess_where_the_server_behind_the_door_is():
    with FoxgloveServer(LOOPBACK, 0, {}) as server, pytest.raises(OSError, match="refused"):
        socket.create_connection((LOOPBACK, server._server.port), timeout=HANG_S)


@pytest.mark.skipif(sys.platform != "linux", reason="counts files in /proc")
def test_who_fills_the_doorway_takes_no_files_from_the_nodes():
    """A process may have a thousand files open: without any, no state would be saved."""
    files = Path("/proc/self/fd")
    with FoxgloveServer(LOOPBACK, 0, {}) as server, ExitStack() as stack:
        port, before = int(server.address.rpartition(":")[2]), len([*files.iterdir()])
        guests = [
            stack.enter_context(socket.create_connection((LOOPBACK, port), timeout=HANG_S))
            for _ in range(10 * MOST_CONNECTIONS)
        ]
        wait_until(lambda: sum(map(sent_away, guests)) >= len(guests) - MOST_CONNECTIONS)
        assert len([*files.iterdir()]) - before - len(guests) <= MOST_CONNECTIONS


def sent_away(guest):
    """True if the other side has closed a connection that sends nothing."""
    guest.setblocking(False)
    try:
        return not guest.recv(1)
    except BlockingIOError:
        return False
    except ConnectionError:
        return True


def test_a_time_before_1970_ends_no_server():
    """A database may hold any number for a time; to Foxglove it has no sign."""
    offered = {"/a": "std_msgs/msg/Float64"}
    with (
        FoxgloveServer(LOOPBACK, 0, offered, replay=True) as server,
        connected(server.address) as app,
    ):
        app.subscribe("/a")
        wait_until(lambda: server.watched)
        server.send_time(-5)
        server.send("/a", offered["/a"], bytes(12), -5)
        assert next(app.messages()).time_ns == 0
