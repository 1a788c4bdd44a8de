"""Units for people and files; code and topics use SI."""

from __future__ import annotations

from enum import Enum
import math
from typing import NamedTuple

JOULES_PER_KWH, JOULES_PER_WH = 3.6e6, 3600.0
KMH = 1 / 3.6  # m/s
MEGABYTE, MEBIBYTE = 1e6, 1 << 20


SMALL_KWH = 0.1  # an hour of a robot, 500 m of a car; less is shown with two more digits


def kwh_digits(kwh: float, usual: int) -> int:
    """Digits after the point of energies whose largest is `kwh`: `usual`, or two more."""
    return usual + 2 if abs(kwh) < SMALL_KWH else usual


def fixed(value: float, digits: int, sign: str = "") -> str:
    """A number with fixed digits after the point, never `-0.0`; sign `+` for differences."""
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}"


def counted(number: int, word: str) -> str:
    """A number with its noun: `1 car`, `2 cars`."""
    return f"{number} {word}{'' if number == 1 else 's'}"


def with_sigma(value: float, sigma: float) -> str:
    """Value and 1-sigma, both to the second digit of the 1-sigma: `2020 ± 230`."""
    return f"{_as_exact(value, sigma)} ± {two_digits(sigma)}"


def two_digits(value: float) -> str:
    """A positive number with two significant digits, without an exponent: `230`, `0.0012`."""
    return _as_exact(value, value)


def _as_exact(value: float, sigma: float) -> str:
    places = 1 - math.floor(math.log10(sigma)) if 0.0 < sigma < math.inf else 0
    return f"{round(value, places):.{max(places, 0)}f}"


class Units(NamedTuple):
    """Names of units, and their size in SI."""

    distance: str  # name
    metres: float  # in one unit of distance
    speed: str  # name of one unit of distance per hour
    speed_step: float  # between groups of speeds on a chart
    height: str  # name
    height_metres: float  # in one unit of height
    temperature: str  # name
    degrees: float  # units of temperature in one kelvin
    zero: float  # temperature at 0 degrees Celsius
    rate: str  # name of energy per distance, which adds up
    rate_joules: float  # J/m in one unit of rate

    @property
    def speeds(self) -> float:
        """Units of speed in one m/s."""
        return 3600.0 / self.metres

    @property
    def economy(self) -> str:
        """Name of the unit of `consumption`."""
        return self.rate if self is METRIC else f"{self.distance}/kWh"

    def consumption(self, joules: float, metres: float) -> str:
        """Text of the consumption, in the unit `economy`, from energy, J, and distance, m."""
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
        """The units of this system."""
        return US if self is UnitSystem.US else METRIC
