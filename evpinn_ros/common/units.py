"""Units that people and files have, in SI, which the code and the topics have."""

from __future__ import annotations

from enum import Enum
import math
from typing import NamedTuple

JOULES_PER_KWH, JOULES_PER_WH = 3.6e6, 3600.0
KMH = 1 / 3.6  # m/s
MEGABYTE, MEBIBYTE = 1e6, 1 << 20


SMALL_KWH = 0.1  # of a robot's hour or a car's half kilometre: two more digits are worth showing


def kwh_digits(kwh: float, usual: int) -> int:
    """Digits of energies in a table whose largest is this one, kWh."""
    return usual + 2 if abs(kwh) < SMALL_KWH else usual


def fixed(value: float, digits: int, sign: str = "") -> str:
    """A number to so many digits, without a minus before zeros; sign `+` for differences."""
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}"


def counted(number: int, word: str) -> str:
    """Number of things with their word: `1 car`, `2 cars`."""
    return f"{number} {word}{'' if number == 1 else 's'}"


def with_sigma(value: float, sigma: float) -> str:
    """Value and 1-sigma, both to the second digit of the latter: `2020 ± 230`."""
    return f"{_as_exact(value, sigma)} ± {two_digits(sigma)}"


def two_digits(value: float) -> str:
    """A positive number to its second digit, without an exponent: `230`, `0.0012`."""
    return _as_exact(value, value)


def _as_exact(value: float, sigma: float) -> str:
    places = 1 - math.floor(math.log10(sigma)) if 0.0 < sigma < math.inf else 0
    return f"{round(value, places):.{max(places, 0)}f}"


class Units(NamedTuple):
    """Names of units, and what one of each is in SI."""

    distance: str  # name
    metres: float  # of one distance
    speed: str  # name of one distance an hour
    speed_step: float  # speeds that stand apart on a chart
    height: str  # name
    height_metres: float  # of one height
    temperature: str  # name
    degrees: float  # of the temperature in one kelvin
    zero: float  # temperature at 0 degrees Celsius
    rate: str  # name of energy over distance, which adds up
    rate_joules: float  # a metre of one rate

    @property
    def speeds(self) -> float:
        """Speeds in one m/s."""
        return 3600.0 / self.metres

    @property
    def economy(self) -> str:
        """Name of what `consumption` states."""
        return self.rate if self is METRIC else f"{self.distance}/kWh"

    def consumption(self, joules: float, metres: float) -> str:
        """Energy over distance as people state it, in units of `economy`."""
        if self is METRIC:
            return fixed(joules / metres / self.rate_joules, 1)
        return f"{metres / self.metres * JOULES_PER_KWH / joules:.1f}" if joules > 0 else "-"


METRIC = Units("km", 1000.0, "km/h", 10.0, "m", 1.0, "°C", 1.0, 0.0, "kWh/100 km", 36.0)
US = Units("mi", 1609.344, "mph", 5.0, "ft", 0.3048, "°F", 1.8, 32.0, "Wh/mi", 3600.0 / 1609.344)


class UnitSystem(str, Enum):
    """Units by the name that `--units` takes."""

    METRIC = "metric"
    US = "us"

    @property
    def units(self) -> Units:
        """The units of it."""
        return US if self is UnitSystem.US else METRIC
