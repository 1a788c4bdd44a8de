"""The connection with a broker that sends what no broker should."""

from __future__ import annotations

import socket
import threading

import pytest

from evpinn_ros.extras.bridges.broker import LONGEST_PAYLOAD, BrokerSettings, Connection
from test.waiting import HANG_S, wait_until

CONNECTED, SUBSCRIBED = b"\x20\x02\x00\x00", b"\x90\x03\x00\x01\x01"


def published(topic, payload):
    """A PUBLISH of MQTT 3.1.1 with QoS 0."""
    content = len(topic).to_bytes(2, "big") + topic + payload
    length, left = b"", len(content)
    while True:
        left, low = divmod(left, 128)
        length += bytes((low | (0x80 if left else 0),))
        if not left:
            return b"\x30" + length + content


@pytest.fixture
def rogue():
    """Port of a broker that sends packets as they are to whoever connects."""
    packets: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            with server.accept()[0] as client:
                client.recv(4096)
                client.sendall(CONNECTED)
                client.recv(4096)
                client.sendall(SUBSCRIBED + b"".join(packets))
                while client.recv(4096):
                    pass

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield server.getsockname()[1], packets
        thread.join(HANG_S)


def test_what_cannot_be_read_is_counted_and_the_next_message_comes(rogue):
    port, packets = rogue
    packets += [
        published(b"cars/\xff\xfe", b"1"),
        published(b"cars/1", b"x" * (LONGEST_PAYLOAD + 1)),
        published(b"cars/2", b"9"),
    ]
    connection = Connection(BrokerSettings("127.0.0.1", port), ("cars/+",), "evpinn/status")
    connection.start()
    try:
        message = connection.next_message(HANG_S)
        assert message is not None and (message.topic, message.payload) == ("cars/2", b"9")
        assert connection.lost == 2
        wait_until(lambda: connection.connected)
    finally:
        connection.close()
