"""A real mosquitto for each test that wants one, and drives as other programs publish them."""

from __future__ import annotations

from dataclasses import dataclass, field
import getpass
from pathlib import Path
import shutil
import socket
import subprocess
import time

import paho.mqtt.client as mqtt
import pytest

from evpinn_ros.extras.bridges.bridge import MqttBridge
from evpinn_ros.extras.bridges.broker import BrokerSettings, Connection
from test.waiting import HANG_S, wait_until

MOSQUITTO = shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@dataclass
class Broker:
    """A mosquitto that can be killed and started again; it remembers nothing then.

    Its clients are closed when the test ends.
    """

    folder: Path
    port: int
    lines: str = "allow_anonymous true\n"
    process: subprocess.Popen[bytes] | None = None
    clients: list[Client] = field(default_factory=list)

    def start(self):
        config = self.folder / "mosquitto.conf"
        # As root it would become a user who may not read what the tests write.
        common = f"user {getpass.getuser()}\nset_tcp_nodelay true\n"
        config.write_text(f"{common}listener {self.port} 127.0.0.1\n{self.lines}")
        with self.log.open("w") as log:
            self.process = subprocess.Popen([MOSQUITTO, "-c", config], stdout=log, stderr=log)
        wait_until(self._answers)

    @property
    def log(self):
        return self.folder / "mosquitto.log"

    def settle(self, reader, end):
        """Return once a reader has all that came before a message on topic `end`."""
        self.client().publish(end, "", retain=False)
        wait_until(lambda: end in reader.newest())
        reader.came.remove((end, "", False))

    def _answers(self):
        with socket.socket() as tried:
            return tried.connect_ex(("127.0.0.1", self.port)) == 0

    def kill(self):
        if self.process is not None:
            self.process.kill()
            self.process.wait()

    def client(self, **of):
        self.clients.append(Client(self.port, **of))
        return self.clients[-1]


class Client:
    """A plain client: publishes, and keeps all that comes."""

    def __init__(self, port, topics=()):
        self.client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        self.came: list[tuple[str, str, bool]] = []
        self.client.on_connect = lambda client, *_: [client.subscribe(t, 1) for t in topics]
        self.client.on_message = lambda _, __, m: self.came.append(
            (m.topic, m.payload.decode(), m.retain)
        )
        granted: list[int] = []
        self.client.on_subscribe = lambda _, __, number, *___: granted.append(number)
        self.client.connect("127.0.0.1", port)
        self.client.loop_start()
        wait_until(lambda: self.client.is_connected() and len(granted) >= len(topics))

    def publish(self, topic, payload, *, retain=True):
        self.client.publish(topic, payload, 1, retain).wait_for_publish(HANG_S)

    def newest(self):
        return {topic: payload for topic, payload, _ in self.came}

    def close(self):
        self.client.disconnect()
        self.client.loop_stop()


@pytest.fixture
def broker(tmp_path):
    if MOSQUITTO is None:
        pytest.skip("mosquitto")
    served = Broker(tmp_path, free_port())
    served.start()
    yield served
    for client in served.clients:
        client.close()
    served.kill()


@pytest.fixture
def bridged(broker):
    """Makes bridges that are connected to the broker."""
    made: list[Connection] = []

    def make(settings, clock=time.time_ns, **of):
        address = BrokerSettings("127.0.0.1", broker.port, **of)
        connection = Connection(address, settings.subscriptions, settings.status_topic, clock)
        bridge = MqttBridge(settings, connection)
        connection.start()
        made.append(connection)
        wait_until(lambda: bridge.step(0.01) or connection.connected)
        return bridge, connection

    yield make
    for connection in made:
        connection.close()
