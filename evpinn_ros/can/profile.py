"""CAN profiles: the signals of a car's bus that are its speed, battery and motor torque.

A YAML file in `config/can/`, strictly validated. A quantity is a signal of the DBC file, or is
requested (`evpinn_ros.can.request`); the profile adds signs, limits, "not available", protection.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evpinn_ros.can.dbc import DbcFile, Place, find_signal, place_of, refuse_other_unit
from evpinn_ros.can.frame import BusId
from evpinn_ros.can.request import (
    AnswerField,
    RequestRule,
    answer_field,
    refuse_overlaps,
    request_rules,
)
from evpinn_ros.can.signal_rule import (
    POSITIVE_MEANS,
    RULE_KEYS,
    SignalRule,
    refuse_impossible,
    signal_rule,
)
from evpinn_ros.common.errors import InputError, known_names
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.common.yaml_section import Section, compose

MOTORS = ("motor", "second_motor")
QUANTITIES = ("speed", "battery", "state_of_charge", *MOTORS)
ONLY_ASKED = "auxiliary_voltage"
PROTECTION_KEYS = ("checksum", "counter")
SIGNAL_KEYS = ("signal", *RULE_KEYS)
PARTS: Mapping[str, Mapping[str, str]] = {
    "battery": {"voltage": "voltage", "current": "current"},
    "motor": {"torque": "torque", "speed": "motor_speed"},
    "second_motor": {"torque": "torque"},
}
"""Sections of a quantity with several signals, and the `UNITS` key of each."""
BATTERY_PARTS = frozenset(PARTS["battery"])
OPTIONAL_PARTS = (("motor", "speed"), ("second_motor", "torque"))
ChecksumRule = Callable[[int, bytes], int]
"""Maps a frame's id and its bytes without the checksum byte to the checksum byte."""


@dataclass(frozen=True, slots=True)
class MessageRule:
    """One message, with the signals of a quantity in it."""

    message: Any  # the `cantools.database.Message`
    # the rules, in the order of the quantity (battery: voltage, current; motor: torque, speed
    # where the message has it; second motor: torque, none when unknown)
    signals: tuple[SignalRule, ...]
    checksum: ChecksumRule | None  # function that computes the checksum byte, or None
    checksum_byte: int  # index of that byte
    counter: str | None  # name of the signal that counts frames, or None

    @property
    def key(self) -> BusId:
        """The id of the message, and True if it has 29 bits."""
        return int(self.message.frame_id), bool(self.message.is_extended_frame)

    def checksum_of(self, data: bytes) -> int | None:
        """Expected checksum byte of a payload; None if the rule is unknown."""
        if self.checksum is None:
            return None
        before, after = data[: self.checksum_byte], data[self.checksum_byte + 1 :]
        return self.checksum(self.message.frame_id, before + after)


@dataclass(frozen=True, slots=True)
class CanProfile:
    """The signals of one car's bus."""

    key: str  # short name, the file's stem
    name: str  # name for people
    source: str  # origin of the layout
    verified_by: str  # recording that confirms it
    # message of each quantity that the car broadcasts, a subset of `QUANTITIES`; `voltage` and
    # `current` instead of `battery` if each has a message of its own
    messages: Mapping[str, MessageRule]
    # place of each other quantity in the answers to requests, in the order of the quantity
    # (battery: voltage, current). Broadcast or asked, there is a speed or a battery
    asked: Mapping[str, tuple[AnswerField, ...]]
    experimental: bool  # sources disagree; never chosen unless the user names it

    @property
    def quantities(self) -> set[str]:
        """The `QUANTITIES` that the car broadcasts or answers."""
        names = {*self.messages, *self.asked}
        return names - BATTERY_PARTS | {"battery"} if names & BATTERY_PARTS else names

    @property
    def requests(self) -> tuple[RequestRule, ...]:
        """Every request once, in the order of the quantities."""
        fields = (field for fields in self.asked.values() for field in fields)
        return tuple(dict.fromkeys(field.request for field in fields))


def profile_names() -> list[str]:
    """Names of the profiles that come with the package."""
    return sorted(path.stem for path in _profile_directory().glob("*.yaml"))


def bundled_profiles() -> list[CanProfile]:
    """The profiles that come with the package."""
    return [load_profile(name) for name in profile_names()]


def load_profile(name_or_path: str | Path) -> CanProfile:
    """Read a profile by its name or path; InputError has file, line and reason."""
    path = Path(name_or_path)
    if path.suffix.lower() == ".dbc":
        raise InputError(
            f"{path}: a DBC file says neither sign nor range; write a profile (.yaml) that names "
            "it, see docs/explanation/can.md"
        )
    if path.suffix not in (".yaml", ".yml"):
        if str(name_or_path) not in profile_names():
            suggestion = known_names(str(name_or_path), profile_names())
            raise InputError(f"no CAN profile named '{name_or_path}'{suggestion}, or give a path")
        path = _profile_directory() / f"{name_or_path}.yaml"
    return _parse(path)


def _profile_directory() -> Path:
    return share_directory() / "config" / "can"


def _parse(path: Path) -> CanProfile:
    root = compose(path, "CAN profile")
    texts = ("name", "source", "verified_by")
    root.refuse_unknown((*texts, "experimental", "dbc", "requests", *QUANTITIES, ONLY_ASKED))
    asked = _asked(root)
    broadcast = [name for name in QUANTITIES if root.has(name) and name not in asked]
    if "second_motor" in broadcast and "motor" not in broadcast:
        raise root.error_at("second_motor", "'motor' is missing")
    messages = {}
    if broadcast or root.has("dbc"):
        database = DbcFile(root, root.path_beside("dbc"))
        sections = {name: root.section(name) for name in broadcast}
        if "battery" in broadcast and not sections["battery"].has("message"):
            battery = sections.pop("battery")
            battery.refuse_unknown(PARTS["battery"])
            sections |= {part: battery.section(part) for part in PARTS["battery"]}
        messages = {name: _message_rule(part, name, database) for name, part in sections.items()}
    if not {"speed", "battery"} & {*broadcast, *asked}:
        raise root.error("'speed' and 'battery' are missing: a profile needs one of them")
    if "state_of_charge" in messages and "battery" in asked:
        raise root.error_at("state_of_charge", "must be requested, as 'battery' is")
    _refuse_shared_bits(root, messages)
    _refuse_broadcast_ids(root, messages, asked)
    return CanProfile(
        key=path.stem,
        name=root.text("name"),
        source=root.text("source"),
        verified_by=root.text("verified_by"),
        messages=messages,
        asked=asked,
        experimental=root.has("experimental") and root.truth("experimental"),
    )


def _asked(root: Section) -> dict[str, tuple[AnswerField, ...]]:
    if not root.has("requests"):
        if root.has(ONLY_ASKED):
            raise root.error_at(ONLY_ASKED, "can only be requested: 'requests' is missing")
        return {}
    requests = request_rules(root.section("requests"))
    asked = {}
    for quantity in filter(root.has, (*QUANTITIES, ONLY_ASKED)):
        section = root.section(quantity)
        parts = [section.section(part) for part in PARTS["battery"] if section.has(part)]
        is_message = any(part.has("message") for part in (section, *parts))
        if quantity in MOTORS or (is_message and quantity != ONLY_ASKED):
            continue
        if quantity == "battery":
            section.refuse_unknown(("voltage", "current"))
            fields = {part: section.section(part) for part in PARTS["battery"]}
        else:
            fields = {quantity: section}
        asked[quantity] = tuple(answer_field(of, requests, name) for name, of in fields.items())
    answers = [answer for of_quantity in asked.values() for answer in of_quantity]
    refuse_overlaps(root, answers)
    for name in requests.keys() - {answer.request.name for answer in answers}:
        raise root.section("requests").error_at(name, f"no quantity needs request '{name}'")
    return asked


def _refuse_broadcast_ids(
    root: Section,
    messages: Mapping[str, MessageRule],
    asked: Mapping[str, tuple[AnswerField, ...]],
) -> None:
    broadcast = {rule.key for rule in messages.values()}
    for request in (field.request for fields in asked.values() for field in fields):
        if (request.address.tx_id, request.address.extended) in broadcast:
            reason = f"the car itself broadcasts 0x{request.address.tx_id:X}"
            raise root.section("requests").error_at(request.name, reason)


def _refuse_shared_bits(root: Section, messages: Mapping[str, MessageRule]) -> None:
    taken: dict[str, list[tuple[str, bool, Place]]] = {}
    for quantity, rule in messages.items():
        fields = taken.setdefault(rule.message.name, [])
        for name, is_value, place in _fields(rule):
            for other, other_is_value, other_place in fields:
                # Two quantities of a message may share its checksum and counter.
                shared = name == other and not (is_value or other_is_value)
                if place.overlaps(other_place) and not shared:
                    reason = f"'{name}' and '{other}' overlap in '{rule.message.name}'"
                    raise root.error_at(quantity, reason)
            fields.append((name, is_value, place))


def _fields(rule: MessageRule) -> Iterator[tuple[str, bool, Place]]:
    for signal in rule.signals:
        yield signal.name, True, place_of(rule.message.get_signal_by_name(signal.name))
    if rule.counter is not None:
        yield rule.counter, False, place_of(rule.message.get_signal_by_name(rule.counter))
    if rule.checksum is not None:
        first = 8 * rule.checksum_byte
        yield "checksum", False, Place(frozenset(range(first, first + 8)))


def _message_rule(section: Section, quantity: str, database: DbcFile) -> MessageRule:
    message = database.message(section)
    if quantity in PARTS:
        parts = PARTS[quantity]
        section.refuse_unknown(("message", *parts, *PROTECTION_KEYS))
        signals = tuple(
            _part(section.section(part), message, of)
            for part, of in parts.items()
            if section.has(part) or (quantity, part) not in OPTIONAL_PARTS
        )
    else:
        signals = (_part(section, message, quantity, "message", *PROTECTION_KEYS),)
    checksum, checksum_byte = _checksum(section, message)
    counter = find_signal(section, "counter", message).name if section.has("counter") else None
    return MessageRule(message, signals, checksum, checksum_byte, counter)


def _part(section: Section, message: Any, quantity: str, *besides: str) -> SignalRule:
    signed = ("positive_means",) if quantity in POSITIVE_MEANS else ()
    section.refuse_unknown((*SIGNAL_KEYS, *signed, *besides))
    signal = find_signal(section, "signal", message)
    refuse_other_unit(section, signal)
    scale, offset = float(signal.scale), float(signal.offset)
    rule = signal_rule(section, signal.name, quantity, scale, offset)
    refuse_impossible(section, rule, int(signal.length), bool(signal.is_signed))
    return rule


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


def id_sum(can_id: int, payload: bytes) -> int:
    """Sum of both bytes of the id and of the payload, modulo 256 (Tesla; Nissan 0x284)."""
    return ((can_id & 0xFF) + (can_id >> 8) + sum(payload)) & 0xFF


def nissan_crc8(_can_id: int, payload: bytes) -> int:
    """CRC-8 with polynomial 0x85, start 0, most significant bit first (Nissan 0x1DB)."""
    crc = 0
    for byte in payload:
        crc = _CRC8_TABLE[crc ^ byte]
    return crc


def _crc8_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = (byte << 1) ^ (0x185 if byte & 0x80 else 0)
    return byte


_CRC8_TABLE = bytes(_crc8_of_byte(byte) for byte in range(256))

CHECKSUM_RULES: Mapping[str, ChecksumRule] = {"id_sum": id_sum, "nissan_crc8": nissan_crc8}
