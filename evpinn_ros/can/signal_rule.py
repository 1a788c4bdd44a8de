"""Converts the raw bits of one signal to a number in SI units, and checks its range."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math

from evpinn_ros.common.yaml_section import Section

UNITS: Mapping[str, Mapping[str, float]] = {
    "speed": {"km/h": 1 / 3.6, "mph": 0.44704, "m/s": 1.0},
    "voltage": {"V": 1.0},
    "current": {"A": 1.0},
    "state_of_charge": {"%": 0.01, "1": 1.0},
    "auxiliary_voltage": {"V": 1.0},
    "torque": {"N m": 1.0},
    "motor_speed": {"rpm": 2 * math.pi / 60, "rad/s": 1.0},
}
"""Units in which a quantity may be given, each in SI."""

POSITIVE_MEANS: Mapping[str, Mapping[str, float]] = {
    "current": {"charge": 1.0, "discharge": -1.0},
    "torque": {"drive": 1.0, "brake": -1.0},
}
"""Quantities whose sign a profile must state, and the meaning of a positive reading."""

RULE_KEYS = ("unit", "scale", "valid", "not_available")


class UnusableError(Exception):
    """Unusable bits of a frame or an answer; the text is the reason under which they count."""


@dataclass(frozen=True, slots=True)
class SignalRule:
    """Conversion of one signal's raw bits to a number in SI units, and its valid range."""

    name: str  # of the signal in the DBC file, or of the quantity in an answer
    scale: float  # file units per raw step
    offset: float  # file units at raw zero
    si: float  # SI units, with the sign of `evpinn_ros.core.signals.readings`, per file unit
    lower: float  # smallest value the car can show, SI
    upper: float  # largest value the car can show, SI
    not_available: frozenset[int]  # raw values that mean "no value"

    def value(self, raw: float) -> float:
        """The value of the raw bits, SI. File units are computed first: they are exact at rest."""
        return (raw * self.scale + self.offset) * self.si

    def raw(self, value: float) -> int:
        """The raw bits nearest to a value in SI."""
        return round((value / self.si - self.offset) / self.scale)

    def clipped(self, value: float) -> float:
        """The nearest value that the car can show, SI."""
        return min(max(value, self.lower), self.upper)

    def read(self, raw: int) -> float:
        """The value of the raw bits, SI; raises UnusableError if it is no valid value."""
        if raw in self.not_available:
            raise UnusableError("not_available")
        value = self.value(raw)
        if not self.lower <= value <= self.upper:
            raise UnusableError("out_of_range")
        return value

    @property
    def resolution(self) -> float:
        """Size of one raw step, SI."""
        return abs(self.scale * self.si)


def signal_rule(
    section: Section, name: str, quantity: str, scale: float = 1.0, offset: float = 0.0
) -> SignalRule:
    """Read `RULE_KEYS` and the sign that `POSITIVE_MEANS` requires; a sign is never guessed.

    `scale` and `offset` are those of the DBC file. Raises InputError.
    """
    units = UNITS[quantity]
    si = units[section.choice("unit", units)]
    if quantity in POSITIVE_MEANS:
        signs = POSITIVE_MEANS[quantity]
        si *= signs[section.choice("positive_means", signs)]
    bounds = section.numbers("valid", -1e6, 1e6)
    if len(bounds) != 2 or not bounds[0] < bounds[1]:
        raise section.error_at("valid", "'valid' must be [lowest, highest]")
    no_value = section.whole_numbers("not_available") if section.has("not_available") else ()
    factor = section.number("scale", 1e-6, 1e6) if section.has("scale") else 1.0
    lower, upper = sorted(bound * si for bound in bounds)
    return SignalRule(
        name=name,
        scale=scale * factor,
        offset=offset * factor,
        si=si,
        lower=lower,
        upper=upper,
        not_available=frozenset(no_value),
    )


def refuse_impossible(section: Section, rule: SignalRule, bits: int, signed: bool) -> None:
    """Raise InputError if the raw bits can never take a value in `not_available` or `valid`."""
    lowest, highest = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    raw = f"{bits} bits, {'signed' if signed else 'unsigned'}, are {lowest} to {highest}"
    for value in rule.not_available:
        if not lowest <= value <= highest:
            raise section.error_at("not_available", f"{value} is no raw value: {raw}")
    ends = rule.value(lowest), rule.value(highest)
    if max(ends) < rule.lower or min(ends) > rule.upper:
        raise section.error_at("valid", f"no raw value is within 'valid': {raw}")
