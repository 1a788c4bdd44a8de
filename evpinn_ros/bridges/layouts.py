"""Layouts of topics: the quantity, unit and sign behind each topic of TeslaMate, OVMS or a file.

Sources, read in November 2026:
- TeslaMate: its pages "MQTT Integration" and "HomeAssistant Integration" have the names, and power
  in kW (the first says watts and shows the same numbers); its `VehicleSubscriber` sends, retained
  and with QoS 1, what changed, below an optional namespace; its `Summary` rounds speed to km/h.
- OVMS v3: the page "Metrics" of its user guide has names and units; its `metrics_standard.h`
  counts current and power positive out of the battery; its `ovms_server_v3.cpp` sends, retained
  and with QoS 0, what was modified to `ovms/<user>/<vehicle>/metric/`, with `/` for `.`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
import json
import math
from pathlib import Path
import re
from typing import NamedTuple

from evpinn_ros.common.yaml_section import Section, compose
from evpinn_ros.drives.quantities import QUANTITIES, Unit

KMH = 1 / 3.6
PERCENT = 0.01
KILO = 1000.0
MILLISECONDS = 1e11  # a larger number of seconds since 1970 is of milliseconds
CAR_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")


class Measurand(str, Enum):
    """Quantities that a bridge takes, in the units of `signals.readings`.

    POWER is W, positive when drawn; CURRENT is A with the sign of BatteryState, negative when
    drawn; CHARGE is 0..1; STANDING is 1 while the car cannot move, ASLEEP 1 while not in use.
    """

    SPEED = "speed"
    POWER = "power"
    VOLTAGE = "voltage"
    CURRENT = "current"
    CHARGE = "charge"
    ALTITUDE = "altitude"
    LATITUDE = "latitude"
    LONGITUDE = "longitude"
    TEMPERATURE = "temperature"
    HEATING = "heating"
    STANDING = "standing"
    ASLEEP = "asleep"


LASTING = {
    Measurand.CHARGE,
    Measurand.TEMPERATURE,
    Measurand.STANDING,
    Measurand.ASLEEP,
}
"""Quantities whose retained value may be used, once a live message shows that the car sends."""
COLUMNS = {Measurand.ALTITUDE: "elevation", Measurand.TEMPERATURE: "ambient"}
"""Names in `drives.quantities`, where they differ."""


@dataclass(frozen=True, slots=True)
class Rule:
    """Meaning of a topic, or of a field of its JSON.

    Attributes:
        quantity: what the value is of.
        scale: to the unit of the quantity, with its sign.
        offset: added then, as of degrees Fahrenheit.
        resolution: step of the numbers, in the unit of the quantity; NaN if unknown.
        words: texts and their values, where it is no number; others mean `otherwise`.
        otherwise: NaN if other words mean nothing.
    """

    quantity: Measurand
    scale: float = 1.0
    resolution: float = math.nan
    words: Mapping[str, float] | None = None
    otherwise: float = math.nan
    offset: float = 0.0

    def value(self, text: object) -> float:
        """Value in the unit of the quantity, NaN where the text is none."""
        if self.words is not None:
            return self.words.get(str(text), self.otherwise)
        try:
            found = float(str(text)) * self.scale + self.offset
        except ValueError:
            return math.nan
        return found if math.isfinite(found) else math.nan


class Value(NamedTuple):
    """One value of a message."""

    rule: Rule
    value: float


class Parsed(NamedTuple):
    """Content of a message: the car, its values, and their stamp, None if the message has none."""

    car: str
    values: tuple[Value, ...]
    stamp_ns: int | None = None


TESLAMATE_RULES: Mapping[str, Rule] = {
    "speed": Rule(Measurand.SPEED, KMH, resolution=KMH),
    "power": Rule(Measurand.POWER, KILO, resolution=KILO),
    "elevation": Rule(Measurand.ALTITUDE, resolution=1.0),
    "outside_temp": Rule(Measurand.TEMPERATURE),
    "usable_battery_level": Rule(Measurand.CHARGE, PERCENT),
    # An unknown gear comes as an empty text, which is what a parked car has.
    "shift_state": Rule(Measurand.STANDING, words={"P": 1.0, "": 1.0}, otherwise=0.0),
    "state": Rule(Measurand.ASLEEP, words={"driving": 0.0}, otherwise=1.0),
}
OVMS_RULES: Mapping[str, Rule] = {
    "v/p/speed": Rule(Measurand.SPEED, KMH),
    "v/b/power": Rule(Measurand.POWER, KILO),
    "v/b/voltage": Rule(Measurand.VOLTAGE),
    "v/b/current": Rule(Measurand.CURRENT, -1.0),
    "v/b/soc": Rule(Measurand.CHARGE, PERCENT),
    "v/p/altitude": Rule(Measurand.ALTITUDE),
    "v/e/temp": Rule(Measurand.TEMPERATURE),
    "v/e/on": Rule(Measurand.ASLEEP, words={"yes": 0.0, "no": 1.0}),
}


class Layout:
    """Topics of one kind of publisher.

    Attributes:
        subscriptions: topic filters.
        on_change: whether a topic comes only when its value changed, so that any message of a car
            says that all else of it is as it was.
    """

    def __init__(
        self, pattern: str, subscriptions: tuple[str, ...], rules: Mapping[str, Rule]
    ) -> None:
        """Match topics by `pattern`, which has the groups `car` and `name`."""
        self._pattern, self._rules = re.compile(pattern), rules
        self.subscriptions, self.on_change = subscriptions, True

    def parse(self, topic: str, payload: bytes) -> Parsed | None:
        """Content of a message, without values where it has no rule; None if it is of no car."""
        found = self._pattern.fullmatch(topic)
        if found is None or CAR_NAME.fullmatch(found["car"]) is None:
            return None
        rule = self._rules.get(found["name"])
        if rule is None:
            return Parsed(found["car"], ())
        value = rule.value(payload.decode("utf-8", "replace").strip())
        return Parsed(found["car"], () if math.isnan(value) else (Value(rule, value),))


def teslamate(namespace: str = "") -> Layout:
    """Topics of TeslaMate; `namespace` as its MQTT_NAMESPACE."""
    base = f"teslamate/{namespace}/cars" if namespace else "teslamate/cars"
    pattern = rf"{re.escape(base)}/(?P<car>[^/]+)/(?P<name>[^/]+)"
    return Layout(pattern, (f"{base}/+/+",), TESLAMATE_RULES)


def ovms() -> Layout:
    """Topics of a module of OVMS v3; those of vehicle, battery and place alone are asked for."""
    pattern = r"ovms/[^/]+/(?P<car>[^/]+)/metric/(?P<name>.+)"
    parts = ("v/p/#", "v/b/#", "v/e/temp", "v/e/on")
    return Layout(pattern, tuple(f"ovms/+/+/metric/{part}" for part in parts), OVMS_RULES)


class PlainLayout(Layout):
    """Topics of a mapping file; each message is of its own moment."""

    def __init__(self, topics: Mapping[str, Mapping[str, Rule]], stamp: str | None) -> None:
        """Take rules by topic and field; the field "" is the whole payload.

        Args:
            topics: filters with `{car}` where the name of the car stands.
            stamp: field with seconds since 1970, of payloads in JSON; None if there is none.
        """
        self._topics = [
            (re.compile(re.escape(topic).replace(r"\{car\}", "(?P<car>[^/]+)")), rules)
            for topic, rules in topics.items()
        ]
        self._stamp = stamp
        self.subscriptions = tuple(topic.replace("{car}", "+") for topic in topics)
        self.on_change = False

    def parse(self, topic: str, payload: bytes) -> Parsed | None:
        """Content of a message; None where it is of no car."""
        for pattern, rules in self._topics:
            found = pattern.fullmatch(topic)
            if found is not None:
                car = found.groupdict().get("car") or "car"
                return self._values(car, payload, rules) if CAR_NAME.fullmatch(car) else None
        return None

    def _values(self, car: str, payload: bytes, rules: Mapping[str, Rule]) -> Parsed:
        text = payload.decode("utf-8", "replace").strip()
        try:
            fields = {"": text} if "" in rules else json.loads(text)
        except (ValueError, RecursionError):
            fields = {}
        if not isinstance(fields, dict):
            fields = {}
        found = [(rule, rule.value(fields.get(name))) for name, rule in rules.items()]
        values = tuple(Value(rule, value) for rule, value in found if not math.isnan(value))
        return Parsed(car, values, _stamp_ns(fields.get(self._stamp or "")))


def _stamp_ns(seconds: object) -> int | None:
    if not isinstance(seconds, int | float) or not 0 < seconds < 1e13:
        return None
    return round(seconds * (1e9 if seconds < MILLISECONDS else 1e6))


def read_mapping(path: Path) -> PlainLayout:
    """Read a mapping file.

    Its key `topics` maps each topic, with `{car}` for one level, to `{quantity, unit, scale}` or,
    where the payload is JSON, to `fields: {name: {quantity, unit, scale}}`; `unit` is one of
    `drives.quantities`, `scale` a factor beside it; `stamp` names a field, in s or ms.

    Raises:
        InputError: the file is wrong, with its line and the reason.
    """
    root = compose(path, "mapping of topics")
    root.refuse_unknown(("topics", "stamp"))
    topics, section = {}, root.section("topics")
    for topic in section.names():
        entry = section.section(topic)
        if "#" in topic or "+" in topic or topic.count("{car}") > 1:
            raise entry.error("a topic has no wildcard but one {car}")
        if entry.has("fields"):
            fields = entry.section("fields")
            topics[topic] = {name: _rule(fields.section(name)) for name in fields.names()}
        else:
            topics[topic] = {"": _rule(entry)}
    return PlainLayout(topics, root.text("stamp") if root.has("stamp") else None)


def _rule(section: Section) -> Rule:
    section.refuse_unknown(("quantity", "scale", "unit"))
    quantity = Measurand(section.choice("quantity", [each.value for each in Measurand]))
    scale = section.number("scale", -1e9, 1e9) if section.has("scale") else 1.0
    unit = _unit(section, quantity) if section.has("unit") else Unit(1.0)
    return Rule(quantity, scale * unit.factor, offset=unit.offset)


def _unit(section: Section, quantity: Measurand) -> Unit:
    column = QUANTITIES.get(COLUMNS.get(quantity, quantity.value))
    units: Mapping[str, Unit] = {} if column is None else column.units
    unit = units.get(section.text("unit").lower())
    if unit is None:
        known = ", ".join(units) or "none"
        raise section.error_at("unit", f"units of {quantity.value}: {known}")
    # The columns of `drives` hold a charge in percent.
    return Unit(unit.factor * PERCENT) if quantity is Measurand.CHARGE else unit
