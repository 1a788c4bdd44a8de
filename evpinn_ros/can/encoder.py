"""Encodes readings as frames: the inverse of the decoder, for simulated drives and tests."""

from __future__ import annotations

from collections.abc import Sequence

from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import CanProfile, MessageRule
from evpinn_ros.core.signals.readings import BatteryReading, MotorReading, SpeedReading


class Encoder:
    """Encodes the frames of a car with this profile, with counters and checksums.

    Methods raise ValueError for a quantity or a value that the profile cannot encode.
    """

    def __init__(self, profile: CanProfile) -> None:
        self._profile = profile
        self._counters = dict.fromkeys(profile.messages, -1)

    def speed(self, reading: SpeedReading) -> CanFrame:
        """The frame with a speed."""
        return self._frame("speed", reading.stamp_ns, [reading.speed])

    def battery(self, reading: BatteryReading) -> CanFrame:
        """The frame with voltage and current."""
        if "voltage" in self._profile.messages:
            raise ValueError("voltage and current of two messages can be read only")
        return self._frame("battery", reading.stamp_ns, [reading.voltage, reading.current])

    def state_of_charge(self, reading: BatteryReading) -> CanFrame:
        """The frame with the state of charge."""
        return self._frame("state_of_charge", reading.stamp_ns, [reading.state_of_charge])

    def motor(self, reading: MotorReading) -> list[CanFrame]:
        """The frame with torque and speed, after one of a second motor with zero torque."""
        stamp_ns, rules = reading.stamp_ns, self._profile.messages
        frames = []
        if "second_motor" in rules and rules["second_motor"].signals:
            frames.append(self._frame("second_motor", stamp_ns, [0.0]))
        values = [reading.torque, reading.speed]
        count = len(rules["motor"].signals) if "motor" in rules else 0
        return [*frames, self._frame("motor", stamp_ns, values[:count])]

    def _frame(self, quantity: str, stamp_ns: int, values: Sequence[float]) -> CanFrame:
        if quantity not in self._profile.messages:
            raise ValueError(f"profile {self._profile.key} broadcasts no {quantity}")
        rule = self._profile.messages[quantity]
        message = rule.message
        raw = {signal.name: 0 for signal in message.signals}
        raw |= _raw_values(rule, values)
        if rule.counter is not None:
            bits = message.get_signal_by_name(rule.counter).length
            self._counters[quantity] = (self._counters[quantity] + 1) % (1 << bits)
            raw[rule.counter] = self._counters[quantity]
        data = bytearray(message.encode(raw, scaling=False, strict=False))
        if (checksum := rule.checksum_of(bytes(data))) is not None:
            data[rule.checksum_byte] = checksum
        return CanFrame(stamp_ns, message.frame_id, bytes(data), message.is_extended_frame)


def _raw_values(rule: MessageRule, values: Sequence[float]) -> dict[str, int]:
    if rule.message.is_multiplexed():
        raise ValueError(f"message {rule.message.name} is multiplexed: it can be read only")
    raw = {}
    for signal, value in zip(rule.signals, values, strict=True):
        if not signal.lower <= value <= signal.upper:
            bounds = f"[{signal.lower:g}, {signal.upper:g}]"
            raise ValueError(f"{signal.name} = {value:g} is outside {bounds}")
        raw[signal.name] = signal.raw(value)
        if raw[signal.name] in signal.not_available:
            raise ValueError(f"{signal.name} = {value:g} would read as 'not available'")
    return raw
