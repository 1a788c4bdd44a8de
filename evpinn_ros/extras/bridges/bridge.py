"""Connects the MQTT topics of each car to its own chain.

It publishes below `BASE/NAME`: `power` at most once a second, not retained; `energy`,
`consumption`, `range`, `breakdown`, `parameters` and `health` at each change, retained. All are
JSON; each of `sensors.SENSORS` also has a topic. `BASE/status`: `online`, last will `offline`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import math
from pathlib import Path
import time

from evpinn_ros.common.json_text import json_text
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.extras.bridges.broker import FAREWELL_S, ONLINE, Connection, Message
from evpinn_ros.extras.bridges.car import BridgedCar, Document
from evpinn_ros.extras.bridges.layouts import Layout, Parsed
from evpinn_ros.extras.bridges.sensors import SENSORS, discovery
from evpinn_ros.extras.bridges.snapshot import Snapshots, is_due

POWER_NS = 9 * NANOSECONDS // 10  # between powers: one a second from a source with jitter
DOCUMENTS_NS = 10 * NANOSECONDS  # between other documents
SAVE_NS = 60 * NANOSECONDS  # between saved states, as in the nodes
MOST_CARS = 16  # anybody can publish topics of new cars; each takes some ten MB
MOST_HELD = 10_000  # retained messages of silent cars without a name in the settings
WAIT_S = 0.5  # longest wait for a message


@dataclass(frozen=True, slots=True)
class BridgeSettings:
    """Settings of a bridge."""

    layout: Layout  # topics to read
    vehicles: Mapping[str, Vehicle]  # of named cars
    other: Vehicle | None  # of all other cars; None ignores them
    estimator: EstimatorSettings  # settings of each chain
    base: str = "evpinn"  # root of the published topics
    discovery: str = "homeassistant"  # prefix of Home Assistant's discovery; empty for none
    # folder of the saved cars, `NAME.json` each; None saves nothing
    state: Path | None = None

    @property
    def status_topic(self) -> str:
        """Topic of the bridge's birth message and last will."""
        return f"{self.base}/status"

    @property
    def birth_topic(self) -> str:
        """Topic on which Home Assistant announces its start, after which it needs discovery."""
        return f"{self.discovery}/status"

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """Topic filters of the bridge."""
        births = (self.birth_topic,) if self.discovery else ()
        return self.layout.subscriptions + births


@dataclass(slots=True)
class _Seen:
    """A car, its owner, and its published documents."""

    car: BridgedCar
    user: str
    snapshots: Snapshots
    power_ns: int = 0
    documents_ns: int = 0
    published: dict[str, str] = field(default_factory=dict)


class MqttBridge:
    """The cars of one broker, created as their topics arrive."""

    def __init__(
        self,
        settings: BridgeSettings,
        connection: Connection,
        note: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.settings, self._connection = settings, connection
        self._clock, self._note = connection.clock, note
        self._seen: dict[str, _Seen] = {}
        # Names of ignored cars: without a vehicle, above `MOST_CARS`, or of a second user.
        self.ignored: set[str] = set()
        # Retained messages and their arrival, by car, until the car sends.
        self._held: dict[str, list[tuple[Parsed, int]]] = {}
        self._connections = 0
        self._saved_ns = self._clock()

    @property
    def cars(self) -> Mapping[str, BridgedCar]:
        """Cars that have sent messages, by name, in order of their first message."""
        return {name: seen.car for name, seen in self._seen.items()}

    def step(self, wait: float = WAIT_S) -> bool:
        """Take a message within `wait`, s, and publish and save what is due.

        Returns whether a message came.
        """
        now_ns = self._clock()
        due_ns = min((seen.snapshots.due_ns for seen in self._seen.values()), default=math.inf)
        message = self._connection.next_message(min(wait, max(due_ns - now_ns, 0) / NANOSECONDS))
        if self._connections != self._connection.connections:
            self._connections = self._connection.connections
            self._begin_again()
        if message is not None:
            self._take(message)
        now_ns = self._clock()
        for known_car in self._seen.values():
            self._feed(known_car, known_car.snapshots.flush(now_ns))
            self._publish_due(known_car, now_ns)
        if is_due(self._saved_ns, now_ns, SAVE_NS):
            self.save()
            self._saved_ns = now_ns
        self._connection.send()
        return message is not None

    def save(self) -> None:
        """Save the states of all cars; `health` reports a file that cannot be written."""
        for car in self.cars.values():
            before = car.problem
            car.save()
            if car.problem is not None and car.problem != before:
                self._note(car.problem)

    def close(self) -> None:
        """Process waiting messages for some seconds, publish all documents, and save."""
        until = time.monotonic() + FAREWELL_S
        while time.monotonic() < until and self.step(0.0):
            pass
        for seen in self._seen.values():
            self._feed(seen, seen.snapshots.flush(self._clock() + NANOSECONDS))
            self._publish(seen, self._documents(seen.car))
        self.save()

    def _begin_again(self) -> None:
        """After a new connection: drop old values, and publish all documents again."""
        self._held.clear()
        for seen in self._seen.values():
            seen.snapshots.forget()
            self._announce(seen)

    def _take(self, message: Message) -> None:
        if message.topic == self.settings.birth_topic:
            if message.payload == ONLINE.encode() and not message.retained:
                for known_car in self._seen.values():
                    self._announce(known_car)
            return
        parsed = self.settings.layout.parse(message.topic, message.payload)
        if parsed is None or (message.retained and self._hold(parsed, message.arrived_ns)):
            return
        seen = self._car(parsed)
        if seen is None:
            return
        for held, arrived_ns in self._held.pop(parsed.car, ()):
            if held.user == seen.user:
                self._feed(seen, seen.snapshots.add(held, arrived_ns, retained=True))
        retained, arrived_ns = message.retained, message.arrived_ns
        self._feed(seen, seen.snapshots.add(parsed, arrived_ns, retained=retained))

    def _hold(self, retained: Parsed, arrived_ns: int) -> bool:
        """Keep a retained message of an unknown car until it sends; False if the car is known."""
        if retained.car in self._seen or retained.car in self.settings.vehicles:
            return False
        if retained.values and sum(map(len, self._held.values())) < MOST_HELD:
            self._held.setdefault(retained.car, []).append((retained, arrived_ns))
        return True

    def _car(self, parsed: Parsed) -> _Seen | None:
        name, named = parsed.car, self.settings.vehicles
        if name in self._seen:
            seen = self._seen[name]
            if seen.user == parsed.user:
                return seen
            self._ignore(name, f"user '{parsed.user}' has it too; give a --namespace")
            return None
        vehicle = named.get(name, self.settings.other)
        if vehicle is None:
            self._ignore(name, "no vehicle is given for it")
            return None
        if name not in named and len(self._seen.keys() - named) >= MOST_CARS - len(named):
            self._ignore(name, "too many cars")
            return None
        state = self.settings.state and self.settings.state / f"{name}.json"
        car = BridgedCar(name, vehicle, self.settings.estimator, state)
        self._note(f"car '{name}': {vehicle.name}" + (f"; {car.problem}" if car.problem else ""))
        snapshots = Snapshots(vehicle.nominal_voltage, on_change=self.settings.layout.on_change)
        seen = self._seen[name] = _Seen(car, parsed.user, snapshots)
        self._announce(seen)
        return seen

    def _ignore(self, name: str, why: str) -> None:
        if name not in self.ignored and len(self.ignored) < MOST_CARS:
            self.ignored.add(name)
            self._note(f"car '{name}' is ignored: {why}")

    def _feed(self, seen: _Seen, readings: list[Reading]) -> None:
        if readings and seen.car.add_readings(readings):
            seen.documents_ns = 0

    def _publish_due(self, seen: _Seen, now_ns: int) -> None:
        """Publish due documents: the power by the car's stamps, so that replays work, too."""
        newest_ns = seen.car.newest_ns
        if newest_ns is not None and is_due(seen.power_ns, newest_ns, POWER_NS):
            seen.power_ns = newest_ns
            self._publish(seen, {"power": seen.car.power()}, retain=False)
        if is_due(seen.documents_ns, now_ns, DOCUMENTS_NS):
            seen.documents_ns = now_ns
            self._publish(seen, self._documents(seen.car))

    def _documents(self, car: BridgedCar) -> Mapping[str, Document]:
        waiting = {"messages_waiting": self._connection.waiting}
        health = {**car.health(), "messages_lost": self._connection.lost, **waiting}
        return {**car.documents(), "health": health}

    def _publish(
        self, seen: _Seen, documents: Mapping[str, Document], *, retain: bool = True
    ) -> None:
        """Publish documents and their numbers; retained ones only if they changed."""
        base = f"{self.settings.base}/{seen.car.name}"
        for name, document in documents.items():
            texts = {
                sensor.topic: sensor.text(document)
                for sensor in SENSORS
                if sensor.document == name
            }
            for below, text in {name: json_text(document), **texts}.items():
                if not retain or seen.published.get(below) != text:
                    seen.published[below] = text
                    self._connection.publish(f"{base}/{below}", text, retain=retain)

    def _announce(self, seen: _Seen) -> None:
        """Publish the discovery of a car, and all its documents again when they are due."""
        seen.published.clear()
        given, car = self.settings, seen.car
        about = (f"{given.base}/{car.name}", given.status_topic, car.name, car.vehicle.name)
        for topic, content in discovery(given.discovery, *about):
            self._connection.publish(topic, json_text(content), retain=True)
