"""Mappings of MQTT topics to quantities, read from `config/mqtt/` or a user's file."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
import json
import math
from pathlib import Path
import re
from typing import NamedTuple

from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.common.yaml_section import Section, compose
from evpinn_ros.logs.quantities import QUANTITIES, Unit

PERCENT = 0.01
MILLISECONDS = 1e11  # larger numbers since 1970 are milliseconds, not seconds
CAR_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")
BUNDLED = ("teslamate", "ovms")
CAR = "{car}"  # a level of a topic
USER = "(?P<user>[^/]+)"  # of the first wildcard level above the car's
WILDCARDS = {CAR: "(?P<car>[^/]+)", "+": "[^/]+", "#": ".+"}


class Measurand(str, Enum):
    """Quantities that a bridge reads, in the units of `signals.readings`.

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


LASTING = {Measurand.CHARGE, Measurand.TEMPERATURE, Measurand.STANDING, Measurand.ASLEEP}
"""Quantities whose retained values are used after any live message of the car."""
COLUMNS = {Measurand.ALTITUDE: "elevation", Measurand.TEMPERATURE: "ambient"}
"""Names in `logs.quantities`, if different."""


@dataclass(frozen=True, slots=True)
class Rule:
    """Meaning of a topic, or of a field of its JSON."""

    quantity: Measurand
    scale: float = 1.0  # factor to the unit of the quantity, with its sign
    step: float = math.nan  # of rounding, in the unit of the quantity; NaN if unknown
    words: Mapping[str, float] | None = None  # texts and their values, if not a number
    otherwise: float = math.nan  # value of other texts; NaN ignores them
    offset: float = 0.0  # added after `scale`, as of degrees Fahrenheit

    def value(self, text: object) -> Value:
        """The value in the unit of the quantity; NaN if the text has no value."""
        if self.words is not None:
            return Value(self.words.get(str(text), self.otherwise))
        try:
            number = float(str(text)) * self.scale + self.offset
        except ValueError:
            return Value()
        return Value(number, self.step) if math.isfinite(number) else Value()


class Value(NamedTuple):
    """A value and its step of rounding; NaN if unknown."""

    value: float = math.nan
    step: float = math.nan


class Parsed(NamedTuple):
    """Content of a message."""

    car: str  # name of the car
    values: Mapping[Measurand, Value]  # by quantity
    stamp_ns: int | None = None  # None if the message has none
    user: str = ""  # wildcard level above the car's, as of OVMS; empty without one


class Layout:
    """The topics of one type of publisher, with their quantities and units."""

    def __init__(
        self,
        topics: Mapping[str, Mapping[str, Rule]],
        base: str = "",
        around: tuple[str, ...] = (),
        stamp: str = "",
    ) -> None:
        """Make a layout of rules by topic (`{car}` is the car's name) and field ("": the payload).

        `base` is the start of all topics; `around` are topic filters of a publisher that sends
        only changes; `stamp` is the JSON field of the time.

        Raises:
            InputError: a topic is invalid in MQTT.
        """
        rules = {**topics, **{topic: {} for topic in around if topic not in topics}}
        self._rules = {_expression(base + topic): rules[topic] for topic in rules}
        self._stamp = stamp
        self.on_change = bool(around)  # after any message of a car, its other values still hold
        self.subscriptions = tuple((base + topic).replace(CAR, "+") for topic in around or topics)

    def parse(self, topic: str, payload: bytes) -> Parsed | None:
        """Content of a message, without values if it has no rule; None if it is of no car."""
        for expression, rules in self._rules.items():
            match = expression.fullmatch(topic)
            if match is not None:
                levels = {"car": "car", "user": "", **match.groupdict()}
                is_car = CAR_NAME.fullmatch(levels["car"])
                return self._parsed(levels, payload, rules) if is_car else None
        return None

    def _parsed(
        self, levels: Mapping[str, str], payload: bytes, rules: Mapping[str, Rule]
    ) -> Parsed:
        text = payload.decode("utf-8", "replace").strip()
        fields: object = {"": text}
        if "" not in rules:
            with suppress(ValueError, RecursionError):
                fields = json.loads(text)
        fields = fields if isinstance(fields, dict) else {}
        values = [(rule.quantity, rule.value(fields.get(name))) for name, rule in rules.items()]
        measured = {quantity: value for quantity, value in values if not math.isnan(value.value)}
        return Parsed(levels["car"], measured, _stamp_ns(fields.get(self._stamp)), levels["user"])


def _expression(topic: str) -> re.Pattern[str]:
    """Regular expression of the topics of a filter, with the groups `user` and `car`."""
    levels = topic.split("/")
    rest = "/".join(level for level in levels if level not in WILDCARDS)
    broken = not topic or levels.count(CAR) > 1 or "#" in levels[:-1]
    if broken or re.search(r"[+#\0]|\{car\}", rest):
        raise InputError(f"'{topic}': a topic has no wildcard but one level {CAR}")
    parts = [WILDCARDS.get(level) or re.escape(level) for level in levels]
    if CAR in levels and "+" in levels[: levels.index(CAR)]:
        parts[levels.index("+")] = USER
    return re.compile("/".join(parts))


def _stamp_ns(seconds: object) -> int | None:
    if not isinstance(seconds, int | float) or not 0 < seconds < 1e13:
        return None
    return round(seconds * (1e9 if seconds < MILLISECONDS else 1e6))


def read_layout(source: str, namespace: str = "") -> Layout:
    """Read the mapping file of `teslamate` or `ovms`, or the one at a path.

    `topics` maps each topic, with `{car}`, to `{quantity, unit, scale}` or to `fields: {name:
    {...}}` of JSON; `unit` is one of `logs.quantities`, `step` that of rounding; `words` maps
    texts to values, `otherwise` is the value of other texts; `stamp` names a field, s or ms.
    Topics begin with `base`, with a namespace by `named`. `around` are filters of all topics of a
    publisher that sends changes. InputError: the file is wrong, or has no `named` but a namespace.
    """
    bundled = share_directory() / "config" / "mqtt" / f"{source}.yaml"
    path = bundled if source in BUNDLED else Path(source)
    root = compose(path, "mapping of topics")
    root.refuse_unknown(("around", "base", "named", "stamp", "topics"))
    topics, section = {}, root.section("topics")
    for topic in section.names():
        entry = section.section(topic)
        if "#" in topic or "+" in topic:
            raise entry.error("a topic has no wildcard but one level {car}")
        if entry.has("fields"):
            fields = entry.section("fields")
            topics[topic] = {name: _rule(fields.section(name)) for name in fields.names()}
        else:
            topics[topic] = {"": _rule(entry)}

    def text(key: str) -> str:
        return root.text(key) if root.has(key) else ""

    if namespace and not root.has("named"):
        raise root.error("its topics take no --namespace (key 'named' is missing)")
    base = text("named").replace("{namespace}", namespace) if namespace else text("base")
    with as_input_error(path, InputError):
        return Layout(topics, base, tuple(text("around").split()), text("stamp"))


def _rule(section: Section) -> Rule:
    section.refuse_unknown(("otherwise", "quantity", "scale", "step", "unit", "words"))
    quantity = Measurand(section.choice("quantity", [measurand.value for measurand in Measurand]))
    unit = _unit(section, quantity) if section.has("unit") else Unit(1.0)

    def number(key: str, otherwise: float) -> float:
        return section.number(key, -1e9, 1e9) if section.has(key) else otherwise

    scale = number("scale", 1.0) * unit.factor
    step = abs(number("step", math.nan) * scale)
    meanings = None
    if section.has("words"):
        words = section.section("words")
        meanings = {word: words.number(word, -1e9, 1e9) for word in words.names()}
    return Rule(quantity, scale, step, meanings, number("otherwise", math.nan), unit.offset)


def _unit(section: Section, quantity: Measurand) -> Unit:
    column = QUANTITIES.get(COLUMNS.get(quantity, quantity.value))
    units: Mapping[str, Unit] = {} if column is None else column.units
    unit = units.get(section.text("unit").lower())
    if unit is None:
        unit_names = ", ".join(units) or "none"
        raise section.error_at("unit", f"units of {quantity.value}: {unit_names}")
    # The columns of `drives` hold a charge in percent.
    return Unit(unit.factor * PERCENT) if quantity is Measurand.CHARGE else unit
