"""Requests that read (only `READ_SERVICES`): their control unit, payload and period."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
import re
from typing import Literal

from evpinn_ros.can.diagnostic_ids import LAST_11_BIT_ID, refusal
from evpinn_ros.can.frame import BusId, CanFrame
from evpinn_ros.can.signal_rule import RULE_KEYS, SignalRule, refuse_impossible, signal_rule
from evpinn_ros.common.yaml_section import Section

READ_SERVICES: Mapping[int, int] = {0x01: 1, 0x21: 1, 0x22: 2}
"""Services that read and change nothing, with the bytes of their identifier: current data
(OBD-II), ReadDataByLocalIdentifier (KWP2000), ReadDataByIdentifier (UDS)."""

LAST_29_BIT_ID = 0x1FFF_FFFF
LONGEST_ANSWER = 4095  # bytes, by ISO-TP
SHORTEST_PERIOD = 0.05  # s; control units update such values about every 0.1 s
LONGEST_PERIOD = 60.0
QUESTIONS_PER_S = 25
"""Most requests per second of all rules of a profile together."""
REQUEST_KEYS = ("tx", "rx", "target", "source", "read", "min_length", "period")
VALUE_KEYS = ("request", "first_byte", "type", "offset", *RULE_KEYS)
_TYPE = re.compile(r"(?P<sign>[su])(?P<bits>8|16|24|32)(?P<little>_le)?")


Send = Callable[[CanFrame], bool]
"""Sends a frame; returns False without a bus. The frame's stamp is ignored."""


@dataclass(frozen=True, slots=True)
class Address:
    """One control unit on the bus."""

    tx_id: int  # id of the requests
    rx_id: int  # id of the answers
    extended: bool  # True if both ids have 29 bits
    target: int | None  # first byte of every request (extended addressing), or None
    source: int | None  # first byte of every answer (extended addressing), or None

    @property
    def prefix(self) -> bytes:
        """Bytes before the ISO-TP bytes of a frame to the control unit."""
        return b"" if self.target is None else bytes((self.target,))

    @property
    def answers_from(self) -> BusId:
        """The id of the answers, and True if it has 29 bits."""
        return self.rx_id, self.extended


@dataclass(frozen=True, slots=True)
class RequestRule:
    """One request to one control unit."""

    name: str  # in the profile
    address: Address  # of the control unit
    payload: bytes  # the service and its identifier
    min_length: int  # least bytes of an answer after its echo of the identifier
    period_s: float  # time between requests

    @property
    def echo(self) -> bytes:
        """First bytes of a positive answer."""
        return bytes((self.payload[0] + 0x40,)) + self.payload[1:]


@dataclass(frozen=True, slots=True)
class Answer:
    """A positive answer: stamp of its first frame, its request, and the bytes after the echo."""

    stamp_ns: int
    request: RequestRule
    data: bytes


@dataclass(frozen=True, slots=True)
class AnswerField:
    """Place of a value in an answer."""

    request: RequestRule  # the request
    first: int  # index of its first byte after the echo
    length: int  # in bytes
    signed: bool  # two's complement
    byte_order: Literal["big", "little"]  # order of its bytes
    signal: SignalRule  # meaning of the raw value

    def raw(self, data: bytes) -> int:
        """The raw value in the bytes after the echo, at least `min_length`."""
        part = data[self.first : self.first + self.length]
        return int.from_bytes(part, self.byte_order, signed=self.signed)


def request_rules(section: Section) -> dict[str, RequestRule]:
    """Read the section `requests` of a profile.

    InputError: a key or an id is wrong, a service does not read, two answers look alike, or the
    requests together are too frequent.
    """
    rules = {name: _request_rule(section.section(name), name) for name in section.names()}
    for earlier, other in combinations(rules.values(), 2):
        if earlier.address.answers_from == other.address.answers_from:
            if earlier.address != other.address:
                reason = f"'{earlier.name}' and '{other.name}' share only the answer id"
                raise section.error_at(other.name, reason)
            if earlier.payload == other.payload:
                raise section.error_at(other.name, f"asks the same as '{earlier.name}'")
    pace = sum(1 / rule.period_s for rule in rules.values())
    if pace > QUESTIONS_PER_S:
        raise section.error(f"{pace:.3g} requests a second; at most {QUESTIONS_PER_S} are allowed")
    return rules


def answer_field(
    section: Section, requests: Mapping[str, RequestRule], quantity: str
) -> AnswerField:
    """Place of a quantity in the answer to one of `requests`; InputError if invalid."""
    section.refuse_unknown((*VALUE_KEYS, *(("positive_means",) if quantity == "current" else ())))
    request = requests[section.choice("request", requests)]
    kind = _TYPE.fullmatch(section.text("type"))
    if kind is None:
        raise section.error_at("type", "'type' must be u8, s8, u16, s16... u32, s32, or u16_le...")
    first, length = section.whole("first_byte", 0, LONGEST_ANSWER), int(kind["bits"]) // 8
    if first + length > request.min_length:
        reason = f"ends behind min_length = {request.min_length} of request '{request.name}'"
        raise section.error_at("first_byte", reason)
    offset = section.number("offset", -1e6, 1e6) if section.has("offset") else 0.0
    signed = kind["sign"] == "s"
    rule = replace(signal_rule(section, quantity, quantity), offset=offset)
    refuse_impossible(section, rule, 8 * length, signed)
    return AnswerField(
        request=request,
        first=first,
        length=length,
        signed=signed,
        byte_order="big" if kind["little"] is None else "little",
        signal=rule,
    )


def refuse_overlaps(root: Section, fields: Iterable[AnswerField]) -> None:
    """Raise InputError if two values use the same byte of an answer."""
    ordered = sorted(fields, key=lambda field: (field.request.name, field.first))
    for before, other in pairwise(ordered):
        if before.request is other.request and before.first + before.length > other.first:
            names = f"{before.signal.name} and {other.signal.name}"
            raise root.error(f"{names} overlap in the answer to '{before.request.name}'")


def _request_rule(section: Section, name: str) -> RequestRule:
    section.refuse_unknown(REQUEST_KEYS)
    return RequestRule(
        name=name,
        address=_address(section),
        payload=_payload(section),
        min_length=section.whole("min_length", 1, LONGEST_ANSWER),
        period_s=section.number("period", SHORTEST_PERIOD, LONGEST_PERIOD),
    )


def _address(section: Section) -> Address:
    tx_id, rx_id = (section.whole(key, 0, LAST_29_BIT_ID) for key in ("tx", "rx"))
    extended = tx_id > LAST_11_BIT_ID
    if extended != (rx_id > LAST_11_BIT_ID):
        raise section.error_at("rx", "'tx' and 'rx' must both have 11 bits or both 29")
    if tx_id == rx_id:
        raise section.error_at("rx", "'rx' must differ from 'tx'")
    if section.has("target") != section.has("source"):
        raise section.error("extended addressing needs both 'target' and 'source'")
    target, source = (
        section.whole(key, 0, 0xFF) if section.has(key) else None for key in ("target", "source")
    )
    if reason := refusal(tx_id, rx_id, target, source):
        raise section.error_at("tx", reason)
    return Address(tx_id, rx_id, extended, target, source)


def _payload(section: Section) -> bytes:
    try:
        payload = bytes.fromhex(section.text("read"))
    except ValueError:
        raise section.error_at("read", "'read' must be bytes such as 22 01 01") from None
    services = ", ".join(f"{service:02X}" for service in READ_SERVICES)
    if not payload or payload[0] not in READ_SERVICES:
        raise section.error_at("read", f"'read' must begin with a service that reads: {services}")
    if len(payload) != 1 + READ_SERVICES[payload[0]]:
        wanted = READ_SERVICES[payload[0]]
        reason = f"service {payload[0]:02X} takes an identifier of {wanted} byte(s)"
        raise section.error_at("read", reason)
    return payload
