"""Connection to an MQTT broker: bounded queues both ways, reconnects after every loss.

Both directions use QoS 1. For a slow broker only the newest payload of each topic waits, and at
most `IN_FLIGHT` messages are unacknowledged.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from queue import Empty, Full, Queue
import ssl
import sys
import time
from typing import TYPE_CHECKING, Any, NamedTuple

from evpinn_ros.common.errors import as_input_error
from evpinn_ros.common.optional import optional_imports

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessageInfo

PORT, TLS_PORT = 1883, 8883
IN_FLIGHT = 20  # messages
MOST_WAITING = 10_000  # received, unprocessed messages; a minute of 160 a second
LONGEST_PAYLOAD = 16_000  # bytes; no value is larger, and 10,000 of this size take 160 MB
RECONNECT_S = 1, 30  # first and longest wait; each wait is twice the one before
KEEP_ALIVE_S = 30
FAREWELL_S = 3.0  # to send the last messages
ONLINE, OFFLINE = "online", "offline"
REFUSALS = {"Bad user name or password", "Not authorized", "Client identifier not valid"}


@dataclass(frozen=True, slots=True)
class BrokerSettings:
    """Address of a broker and credentials; its repr hides the password.

    `ca`, `certificate` and `key` are paths. Two processes with one `client_id` disconnect each
    other.
    """

    host: str
    port: int = PORT
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: bool = False
    ca: str | None = None
    certificate: str | None = None
    key: str | None = None
    client_id: str = "evpinn"

    @property
    def address(self) -> str:
        """URL of the broker, without name and password."""
        return f"{'mqtts' if self.tls else 'mqtt'}://{self.host}:{self.port}"


class Message(NamedTuple):
    """A received message with its time of arrival, ns since 1970."""

    topic: str
    payload: bytes
    retained: bool
    arrived_ns: int


class Connection:
    """A client of a broker, with its own thread."""

    def __init__(
        self,
        settings: BrokerSettings,
        subscriptions: tuple[str, ...],
        status_topic: str,
        clock: Callable[[], int] = time.time_ns,
    ) -> None:
        """Prepare a client whose last will says `offline`; InputError without paho-mqtt."""
        with optional_imports():
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        self.settings, self._subscriptions, self._status = settings, subscriptions, status_topic
        self.clock = clock  # for times of arrival
        self.lost = self.connections = 0  # dropped messages; number of connections
        self.problem: str | None = None  # why there is no connection, if known
        self._arrived: Queue[Message] = Queue(MOST_WAITING)
        self._outbox: dict[str, tuple[str, bool]] = {}
        self._in_flight: deque[MQTTMessageInfo] = deque()
        client = Client(CallbackAPIVersion.VERSION2, settings.client_id)
        if settings.user is not None:
            client.username_pw_set(settings.user, settings.password)
        if settings.tls:
            with as_input_error(settings.ca or settings.certificate or "TLS", ssl.SSLError):
                client.tls_set(settings.ca, settings.certificate, settings.key)
        client.will_set(status_topic, OFFLINE, qos=1, retain=True)
        client.reconnect_delay_set(*RECONNECT_S)
        client.max_inflight_messages_set(IN_FLIGHT)
        client.on_connect = self._on_connect
        client.on_connect_fail = self._on_connect_fail
        client.on_message = self._on_message
        self._client: Client = client

    @property
    def connected(self) -> bool:
        """True while connected to the broker."""
        return self._client.is_connected()

    @property
    def hopeless(self) -> bool:
        """True if the broker never accepted this client and refuses its credentials."""
        return not self.connections and self.problem in REFUSALS

    def start(self) -> None:
        """Connect in the background, with retries."""
        self._client.connect_async(self.settings.host, self.settings.port, KEEP_ALIVE_S)
        self._client.loop_start()

    def next_message(self, timeout: float) -> Message | None:
        """Next message; None if none comes within `timeout`, s."""
        try:
            return self._arrived.get(timeout=timeout)
        except Empty:
            return None

    def publish(self, topic: str, payload: str, *, retain: bool = False) -> None:
        """Send a payload as soon as the broker can take it; the newest of a topic wins."""
        self._outbox[topic] = payload, retain
        self.send()

    def send(self) -> None:
        """Pass waiting payloads to the client, as far as the broker keeps up."""
        while self._outbox and self.connected and self._on_the_way() < IN_FLIGHT:
            topic = next(iter(self._outbox))
            payload, retain = self._outbox.pop(topic)
            self._in_flight.append(self._client.publish(topic, payload, 1, retain))

    def _on_the_way(self) -> int:
        """Number of unacknowledged messages, which the client sends again after a loss."""
        while self._in_flight and self._in_flight[0].is_published():
            self._in_flight.popleft()
        return len(self._in_flight)

    @property
    def waiting(self) -> int:
        """Number of topics whose newest payload was not sent or not acknowledged."""
        return len(self._outbox) + self._on_the_way()

    def close(self) -> None:
        """Send waiting payloads for some seconds, then `offline`, and disconnect."""
        self.publish(self._status, OFFLINE, retain=True)
        until = time.monotonic() + FAREWELL_S
        while self.connected and self.waiting and time.monotonic() < until:
            self.send()
            time.sleep(0.01)
        self._client.disconnect()
        self._client.loop_stop()

    def _on_connect(self, client: Client, _: Any, __: Any, reason: Any, ___: Any) -> None:
        if reason.is_failure:
            self.problem = str(reason)
            return
        self.problem = None
        client.subscribe([(topic, 1) for topic in self._subscriptions])
        client.publish(self._status, ONLINE, 1, retain=True)
        self.connections += 1

    def _on_connect_fail(self, _: Client, __: Any) -> None:
        # The client calls this while it handles the error, but does not pass the reason.
        error = sys.exc_info()[1]
        self.problem = error.strerror if isinstance(error, OSError) else None

    def _on_message(self, _: Any, __: Any, message: Any) -> None:
        if len(message.payload) > LONGEST_PAYLOAD:
            self.lost += 1
            return
        try:
            arrived = Message(message.topic, message.payload, message.retain, self.clock())
            self._arrived.put_nowait(arrived)
        except (Full, UnicodeDecodeError):  # of a topic; it would end the client's thread
            self.lost += 1
