"""Decodes frames, and answers to requests, to readings by the rules of a profile."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping
import math
from typing import Any

from evpinn_ros.can.fit import MessageFit, ProfileFit
from evpinn_ros.can.frame import MOST_IDS, BusId, CanFrame
from evpinn_ros.can.profile import ONLY_ASKED, CanProfile, MessageRule
from evpinn_ros.can.request import Answer, AnswerField
from evpinn_ros.can.signal_rule import UnusableError
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    MotorReading,
    Reading,
    SpeedReading,
)

STUCK_AFTER = 5
"""Frames in a row with one counter value after which the sender counts as frozen. Logs that lose
frames repeat a value now and then, so a single repetition proves nothing."""

CHARGE_HOLD_NS = 10 * NANOSECONDS
"""Time for which a state of charge is added to later battery readings. Cars send it about once
a second, in another message; at 100 kW it changes by less than 0.5 % in this time."""

TORQUE_HOLD_NS = NANOSECONDS // 5
"""Time for which a second motor's torque is added to that of the first. Cars send both 100 times a
second; logs of slow adapters hold one frame of each about every 0.1 s."""

ALONE_AFTER_NS = 2 * NANOSECONDS
"""Without a frame of the second motor for this time after the first's, the car has none."""

PARTS = ("voltage", "current")
READ_ORDER = ("state_of_charge", "second_motor", "motor", "speed", "battery", *PARTS)
"""Quantities of one message in reading order: a value comes before those that it completes."""

JOIN_NS = NANOSECONDS // 5
"""Voltage and current of two answers or messages at most this far apart form one reading, at the
time of the current: it can change by 100 A in this time, a pack's voltage by 2 %. Behind a slow
adapter they may be farther apart; they are then two readings with their own stamps."""

Unpack = Callable[[bytes], dict[str, int]]
"""Maps a payload to raw values by name, for signals that lie wholly in it."""


class Decoder:
    """Decodes the frames of one bus. `decode` never raises: unusable values are counted."""

    def __init__(self, profile: CanProfile, fit: ProfileFit | None = None) -> None:
        """Decode by a profile; `fit`, of the same profile, gets the result of every frame."""
        self.known = 0  # frames with an id of the profile
        self.unknown: Counter[int] = Counter()  # frames of other ids, for the first `MOST_IDS`
        self.uncounted = 0  # frames of further ids
        # unused values by reason: `short_frame`, `undecodable`, `bad_checksum`,
        # `unknown_multiplexer`, `stuck_counter`, `not_available`, `out_of_range`
        self.dropped: Counter[str] = Counter()
        self._readers: dict[BusId, list[_Reader]] = {}
        self._charge, self._second_torque = _HeldValue(CHARGE_HOLD_NS), _HeldValue(TORQUE_HOLD_NS)
        self._pairs = _Pairs(self._charge)
        self._has_second_motor = "second_motor" in profile.messages
        self._first_torque_ns: int | None = None
        fits = {message.quantity: message for message in fit.messages} if fit is not None else {}
        for quantity in READ_ORDER:
            if quantity in profile.messages:
                rule = profile.messages[quantity]
                reader = _Reader(quantity, rule, fits.get(quantity))
                self._readers.setdefault(rule.key, []).append(reader)

    def decode(self, frame: CanFrame) -> tuple[Reading, ...]:
        """The readings in a frame; none if its id is unknown or its values are unusable."""
        readers = self._readers.get(frame.key)
        if readers is None:
            if frame.can_id in self.unknown or len(self.unknown) < MOST_IDS:
                self.unknown[frame.can_id] += 1
            else:
                self.uncounted += 1
            return ()
        self.known += 1
        readings: list[Reading] = []
        for reader in readers:
            try:
                values = reader.values(frame)
            except UnusableError as reason:
                self.dropped[str(reason)] += 1
                if reader.fit is not None:
                    reader.fit.add_bad(frame, str(reason))
                continue
            if values is None:
                continue
            if reader.fit is not None:
                reader.fit.add_good(frame, values[0])
            if reader.quantity in PARTS:
                readings += self._pairs.add(frame.stamp_ns, reader.quantity, values[0])
            elif (reading := self._reading(reader, frame.stamp_ns, values)) is not None:
                readings.append(reading)
        return tuple(readings)

    def _reading(self, reader: _Reader, stamp_ns: int, values: list[float]) -> Reading | None:
        """The reading of a quantity's values; None for a value that completes other readings."""
        match reader.quantity:
            case "speed":
                return _speed_reading(stamp_ns, values[0], reader.rule.signals[0].resolution)
            case "battery":
                charge = self._charge.at(stamp_ns)
                return BatteryReading(stamp_ns, values[0], values[1], charge)
            case "state_of_charge":
                self._charge.keep(stamp_ns, values[0])
            case "second_motor":  # NaN if the profile knows only the message
                self._second_torque.keep(stamp_ns, values[0] if values else math.nan)
            case "motor":
                other = self._other_torque(stamp_ns)
                if not math.isnan(other):
                    return MotorReading(stamp_ns, values[0] + other, *values[1:])
        return None

    def _other_torque(self, stamp_ns: int) -> float:
        """Torque of a second motor, N m: 0 in a car without one, NaN while that is unknown."""
        if not self._has_second_motor:
            return 0.0
        if self._second_torque.stamp_ns is not None:
            return self._second_torque.at(stamp_ns)
        if self._first_torque_ns is None or stamp_ns < self._first_torque_ns:
            self._first_torque_ns = stamp_ns
        return 0.0 if stamp_ns - self._first_torque_ns > ALONE_AFTER_NS else math.nan


def _speed_reading(stamp_ns: int, speed: float, step: float) -> SpeedReading:
    # Rounding to a step gives a uniform error: variance step^2 / 12.
    return SpeedReading(stamp_ns, speed, step**2 / 12)


class _HeldValue:
    """A value that is added to readings of other messages, for a limited time."""

    def __init__(self, hold_ns: int) -> None:
        self.stamp_ns: int | None = None
        self._hold_ns, self._value = hold_ns, math.nan

    def keep(self, stamp_ns: int, value: float) -> None:
        self.stamp_ns, self._value = stamp_ns, value

    def at(self, stamp_ns: int) -> float:
        fresh = self.stamp_ns is not None and abs(stamp_ns - self.stamp_ns) <= self._hold_ns
        return self._value if fresh else math.nan


class _Pairs:
    """Joins voltages and currents of separate messages (`JOIN_NS`)."""

    def __init__(self, charge: _HeldValue) -> None:
        self._waiting: dict[str, tuple[int, float]] = {}
        self._charge = charge

    def add(self, stamp_ns: int, part: str, value: float) -> list[BatteryReading]:
        """Take a value of one of `PARTS`, V or A; returns the readings that are now final."""
        alone = {
            name: waiting
            for name, waiting in self._waiting.items()
            if name == part or abs(stamp_ns - waiting[0]) > JOIN_NS
        }
        for name in alone:
            del self._waiting[name]
        readings = [self._reading({name: waiting}) for name, waiting in alone.items()]
        self._waiting[part] = stamp_ns, value
        if len(self._waiting) == len(PARTS):
            pair, self._waiting = self._waiting, {}
            readings.append(self._reading(pair))
        return readings

    def _reading(self, parts: Mapping[str, tuple[int, float]]) -> BatteryReading:
        stamp_ns, _ = parts.get("current") or parts["voltage"]
        voltage, current = (parts.get(name, (0, math.nan))[1] for name in PARTS)
        return BatteryReading(stamp_ns, voltage, current, self._charge.at(stamp_ns))


class _Reader:
    def __init__(self, quantity: str, rule: MessageRule, fit: MessageFit | None) -> None:
        self.quantity, self.rule, self.fit = quantity, rule, fit
        counter = () if rule.counter is None else (rule.counter,)
        self._raw = unpacker(rule.message, {*(signal.name for signal in rule.signals), *counter})
        signals = [rule.message.get_signal_by_name(signal.name) for signal in rule.signals]
        self._pages = [
            (str(signal.multiplexer_signal), frozenset(signal.multiplexer_ids))
            for signal in signals
            if signal.multiplexer_ids
        ]
        self._counter: int | None = None
        self._repeated = 0

    def values(self, frame: CanFrame) -> list[float] | None:
        """SI values; None for another page of a multiplexed message. Raises UnusableError."""
        raw = self._unpack(frame.data)
        self._check_checksum(frame)
        self._check_counter(raw)
        if any(signal.name not in raw for signal in self.rule.signals):
            other_page = any(page in raw and raw[page] not in pages for page, pages in self._pages)
            if len(frame.data) < self.rule.message.length and not other_page:
                raise UnusableError("short_frame")
            return None
        return [signal.read(raw[signal.name]) for signal in self.rule.signals]

    def _unpack(self, data: bytes) -> dict[str, int]:
        try:
            # Cars shorten frames between software versions: read the signals that are there.
            return self._raw(data)
        except Exception:
            # cantools documents DecodeError alone, but a multiplexer or layout of a user's file
            # can raise others, and no frame may stop the bridge.
            paged = self.rule.message.is_multiplexed()
            raise UnusableError("unknown_multiplexer" if paged else "undecodable") from None

    def _check_checksum(self, frame: CanFrame) -> None:
        checksum, position = self.rule.checksum_of(frame.data), self.rule.checksum_byte
        if checksum is None:
            return
        if len(frame.data) <= position:
            raise UnusableError("short_frame")
        if checksum != frame.data[position]:
            raise UnusableError("bad_checksum")

    def _check_counter(self, raw: dict[str, int]) -> None:
        if self.rule.counter is None or self.rule.counter not in raw:
            return
        counter = raw[self.rule.counter]
        self._repeated = self._repeated + 1 if counter == self._counter else 0
        self._counter = counter
        if self._repeated >= STUCK_AFTER:
            raise UnusableError("stuck_counter")


def unpacker(message: Any, names: Collection[str]) -> Unpack:
    """Fast reader of some signals of a `cantools.database.Message`, from the payload as a number.

    cantools reads every signal, which is slow. It is still used, with its exceptions, for
    multiplexed messages, floating-point signals and signals that exceed the message.
    """
    fields = [_Field(message.get_signal_by_name(name)) for name in names]
    bits = 8 * message.length
    if message.is_multiplexed() or any(field.is_float or field.end > bits for field in fields):
        return lambda data: dict(
            message.decode(data, decode_choices=False, scaling=False, allow_truncated=True)
        )
    little = [(field.name, field.end, field.start, field.mask, field.sign) for field in fields
              if field.is_little]  # fmt: skip
    big = [
        (field.name, field.end, field.mask, field.sign) for field in fields if not field.is_little
    ]

    def unpack(data: bytes) -> dict[str, int]:
        size, raw = 8 * len(data), {}
        if little:
            word = int.from_bytes(data, "little")
            for name, end, start, mask, sign in little:
                if end <= size:
                    raw[name] = ((word >> start & mask) ^ sign) - sign
        if big:
            word = int.from_bytes(data, "big")
            for name, end, mask, sign in big:
                if end <= size:
                    raw[name] = ((word >> size - end & mask) ^ sign) - sign
        return raw

    return unpack


class _Field:
    """Place of a signal; bits count from the payload's start in the signal's byte order.

    Motorola signals count from the highest bit of each byte; a DBC file numbers bits within the
    byte, where bit 7 of byte 0 is the very first.
    """

    def __init__(self, signal: Any) -> None:
        self.name, self.is_float = str(signal.name), bool(signal.is_float)
        self.is_little = signal.byte_order == "little_endian"
        self.start = int(signal.start if self.is_little else signal.start ^ 7)
        self.end = self.start + int(signal.length)
        self.mask = (1 << signal.length) - 1
        # Two's complement: (x ^ sign) - sign gives x below the sign bit, else x - 2 sign.
        self.sign = 1 << signal.length - 1 if signal.is_signed else 0


class AnswerDecoder:
    """Decodes the answers of one car to readings; for one thread at a time."""

    def __init__(self, profile: CanProfile) -> None:
        # unused values by reason: `not_available`, `out_of_range`, `not_together` (voltage or
        # current whose partner in the same answer is missing or unusable)
        self.dropped: Counter[str] = Counter()
        self.auxiliary_voltage = math.nan  # V, of the 12 V battery in the last answer, or NaN
        self._fields: dict[str, list[AnswerField]] = {}
        for fields in profile.asked.values():
            for field in fields:
                self._fields.setdefault(field.request.name, []).append(field)
        self._charge = _HeldValue(CHARGE_HOLD_NS)
        self._pairs = _Pairs(self._charge)

    def decode(self, answer: Answer) -> tuple[Reading, ...]:
        """The readings that this answer contains or completes."""
        readings: list[Reading] = []
        values = self._values(answer)
        stamp_ns = answer.stamp_ns
        self.auxiliary_voltage, _ = values.get(ONLY_ASKED, (math.nan, math.nan))
        if "state_of_charge" in values:
            self._charge.keep(stamp_ns, values["state_of_charge"][0])
        if "speed" in values:
            readings.append(_speed_reading(stamp_ns, *values["speed"]))
        asked = {field.signal.name for field in self._fields[answer.request.name]}
        if asked.issuperset(PARTS) and not values.keys() >= {*PARTS}:
            self.dropped["not_together"] += any(part in values for part in PARTS)
            return tuple(readings)
        for part in PARTS:
            if part in values:
                readings += self._pairs.add(stamp_ns, part, values[part][0])
        return tuple(readings)

    def _values(self, answer: Answer) -> dict[str, tuple[float, float]]:
        """Value and step, SI, of each usable quantity in the answer."""
        values = {}
        for field in self._fields[answer.request.name]:
            try:
                value = field.signal.read(field.raw(answer.data))
            except UnusableError as reason:
                self.dropped[str(reason)] += 1
            else:
                values[field.signal.name] = value, field.signal.resolution
        return values
