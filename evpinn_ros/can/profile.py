"""CAN profiles: which signals of a car's DBC file are the speed and the battery.

A profile is a YAML file in `config/can/` beside the DBC file it names. It adds what a DBC cannot
say: which quantity a signal is, the sign of the current, what the car can do at most, the raw
values that mean "not available", and how the frame is protected. It is read strictly.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from evpinn_ros.can.checksum import CHECKSUM_RULES, ChecksumRule
from evpinn_ros.can.dbc import DbcFile, bits, find_signal, refuse_other_unit
from evpinn_ros.errors import InputError
from evpinn_ros.share import share_directory
from evpinn_ros.yaml_section import Section, compose

QUANTITIES = ("speed", "battery", "state_of_charge")
SPEED_UNITS = {"km/h": 1 / 3.6, "mph": 0.44704, "m/s": 1.0}
VOLTAGE_UNITS = {"V": 1.0}
CURRENT_UNITS = {"A": 1.0}
CHARGE_UNITS = {"%": 0.01, "1": 1.0}
POSITIVE_MEANS = {"charge": 1.0, "discharge": -1.0}
PROTECTION_KEYS = ("checksum", "counter")
SIGNAL_KEYS = ("signal", "unit", "scale", "valid", "not_available")


@dataclass(frozen=True, slots=True)
class SignalRule:
    """How the raw bits of one signal become a number in SI units, and which numbers count.

    Attributes:
        name: of the signal in the DBC file.
        scale: DBC units per raw step.
        offset: DBC units at raw zero.
        si: SI units, with the sign of `evpinn_ros.signals.readings`, per DBC unit.
        lower: smallest value the car can show, SI.
        upper: largest value the car can show, SI.
        not_available: raw values that stand for "no value".
    """

    name: str
    scale: float
    offset: float
    si: float
    lower: float
    upper: float
    not_available: frozenset[int]

    def value(self, raw: float) -> float:
        """The value of the raw bits, SI. DBC units come first: they are exact at rest."""
        return (raw * self.scale + self.offset) * self.si

    def raw(self, value: float) -> int:
        """The raw bits nearest to a value in SI."""
        return round((value / self.si - self.offset) / self.scale)

    @property
    def resolution(self) -> float:
        """One raw step, SI."""
        return abs(self.scale * self.si)


@dataclass(frozen=True, slots=True)
class MessageRule:
    """One message and the signals of a quantity in it.

    Attributes:
        message: the `cantools.database.Message`.
        signals: the rules, in the order of the quantity (battery: voltage, current).
        checksum: the function that makes the checksum byte, or None.
        checksum_byte: where that byte is.
        counter: name of the signal that counts frames, or None.
    """

    message: Any
    signals: tuple[SignalRule, ...]
    checksum: ChecksumRule | None
    checksum_byte: int
    counter: str | None


@dataclass(frozen=True, slots=True)
class CanProfile:
    """The signals of one car's bus.

    Attributes:
        key: short name, the file's stem.
        name: name for people.
        source: where the layout was learned.
        verified_by: which recording confirms it.
        messages: the message of each quantity the bus has, a subset of `QUANTITIES` with a
            speed or a battery in it.
    """

    key: str
    name: str
    source: str
    verified_by: str
    messages: Mapping[str, MessageRule]


def profile_names() -> list[str]:
    """Names of the profiles that come with the package."""
    return sorted(path.stem for path in _profile_directory().glob("*.yaml"))


def bundled_profiles() -> list[CanProfile]:
    """The profiles that come with the package."""
    return [load_profile(name) for name in profile_names()]


def load_profile(name_or_path: str | Path) -> CanProfile:
    """Read a profile given by its name (`tesla_model_3`) or by the path of its YAML file.

    Raises:
        InputError: no such profile, or its files are wrong; the text has file, line and reason.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = _profile_directory() / f"{name_or_path}.yaml"
        if not path.is_file():
            known = ", ".join(profile_names())
            raise InputError(
                f"no CAN profile named '{name_or_path}'; known are {known}, or give a path"
            )
    return _parse(path)


def _profile_directory() -> Path:
    return share_directory() / "config" / "can"


def _parse(path: Path) -> CanProfile:
    root = compose(path, "CAN profile")
    root.refuse_unknown(("name", "source", "verified_by", "dbc", *QUANTITIES))
    database = DbcFile(root, path.parent / root.text("dbc"))
    messages = {
        quantity: _message_rule(root.section(quantity), quantity, database)
        for quantity in QUANTITIES
        if root.has(quantity)
    }
    if not {"speed", "battery"} & messages.keys():
        raise root.error("'speed' or 'battery' is missing: the profile would say nothing")
    _refuse_shared_bits(root, messages)
    return CanProfile(
        key=path.stem,
        name=root.text("name"),
        source=root.text("source"),
        verified_by=root.text("verified_by"),
        messages=messages,
    )


class _Field(NamedTuple):
    """What is read from a message: a value, or the counter or checksum that protects it."""

    name: str
    is_value: bool
    pages: frozenset[int]
    bits: frozenset[int]

    def clashes(self, other: _Field) -> bool:
        """Whether both claim one bit; two quantities of a message may share what protects it."""
        if self.name == other.name and not (self.is_value or other.is_value):
            return False
        other_page = self.pages and other.pages and not self.pages & other.pages
        return bool(self.bits & other.bits) and not other_page


def _refuse_shared_bits(root: Section, messages: Mapping[str, MessageRule]) -> None:
    """Raise when two values, or a value and what protects it, are read from the same bits."""
    taken: dict[str, list[_Field]] = {}
    for quantity, rule in messages.items():
        fields = taken.setdefault(rule.message.name, [])
        for field in _fields(rule):
            for other in filter(field.clashes, fields):
                reason = f"'{field.name}' and '{other.name}' overlap in '{rule.message.name}'"
                raise root.error_at(quantity, reason)
            fields.append(field)


def _fields(rule: MessageRule) -> Iterator[_Field]:
    values = [signal.name for signal in rule.signals]
    for name in (*values, *filter(None, (rule.counter,))):
        signal = rule.message.get_signal_by_name(name)
        pages = frozenset(signal.multiplexer_ids or ())
        yield _Field(name, name in values, pages, bits(signal))
    if rule.checksum is not None:
        first = 8 * rule.checksum_byte
        yield _Field("checksum", False, frozenset(), frozenset(range(first, first + 8)))


def _message_rule(section: Section, quantity: str, database: DbcFile) -> MessageRule:
    message = database.message(section)
    if quantity == "battery":
        section.refuse_unknown(("message", "voltage", "current", *PROTECTION_KEYS))
        voltage, current = section.section("voltage"), section.section("current")
        voltage.refuse_unknown(SIGNAL_KEYS)
        current.refuse_unknown((*SIGNAL_KEYS, "positive_means"))
        sign = POSITIVE_MEANS[current.choice("positive_means", POSITIVE_MEANS)]
        signals: tuple[SignalRule, ...] = (
            _signal_rule(voltage, message, VOLTAGE_UNITS),
            _signal_rule(current, message, CURRENT_UNITS, sign),
        )
    else:
        section.refuse_unknown(("message", *SIGNAL_KEYS, *PROTECTION_KEYS))
        units = SPEED_UNITS if quantity == "speed" else CHARGE_UNITS
        signals = (_signal_rule(section, message, units),)
    checksum, checksum_byte = _checksum(section, message)
    counter = find_signal(section, "counter", message).name if section.has("counter") else None
    return MessageRule(message, signals, checksum, checksum_byte, counter)


def _signal_rule(
    section: Section, message: Any, units: Mapping[str, float], sign: float = 1.0
) -> SignalRule:
    signal = find_signal(section, "signal", message)
    refuse_other_unit(section, signal)
    si = sign * units[section.choice("unit", units)]
    bounds = section.numbers("valid", -1e6, 1e6)
    if len(bounds) != 2 or not bounds[0] < bounds[1]:
        raise section.error_at("valid", "'valid' must be [lowest, highest]")
    no_value = _raw_values(section, "not_available") if section.has("not_available") else ()
    scale = section.number("scale", 1e-6, 1e6) if section.has("scale") else 1.0
    lower, upper = sorted(bound * si for bound in bounds)
    return SignalRule(
        name=signal.name,
        scale=float(signal.scale) * scale,
        offset=float(signal.offset) * scale,
        si=si,
        lower=lower,
        upper=upper,
        not_available=frozenset(no_value),
    )


def _raw_values(section: Section, key: str) -> tuple[int, ...]:
    numbers = section.numbers(key, -(2**63), 2**64)
    if not all(number.is_integer() for number in numbers):
        raise section.error_at(key, f"'{key}' holds raw bits: whole numbers")
    return tuple(int(number) for number in numbers)


def _checksum(section: Section, message: Any) -> tuple[ChecksumRule | None, int]:
    if not section.has("checksum"):
        return None, 0
    checksum = section.section("checksum")
    checksum.refuse_unknown(("rule", "signal"))
    signal = find_signal(checksum, "signal", message)
    # A Motorola byte starts at its highest bit, an Intel byte at its lowest.
    first = signal.start - 7 if signal.byte_order == "big_endian" else signal.start
    if signal.length != 8 or first % 8:
        raise checksum.error_at("signal", f"'{signal.name}' is not one whole byte")
    return CHECKSUM_RULES[checksum.choice("rule", CHECKSUM_RULES)], first // 8
