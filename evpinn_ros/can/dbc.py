"""DBC files of whatever origin: what a profile names in one, found or refused with the reason."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from io import TextIOWrapper
from itertools import combinations
from pathlib import Path
import re
from typing import Any, NamedTuple

import cantools

from evpinn_ros.common.errors import near_names
from evpinn_ros.common.opener import open_file
from evpinn_ros.common.yaml_section import Section

_SPEED_UNITS: Mapping[str, str] = {
    **dict.fromkeys(("km/h", "kph", "kmh", "kmph"), "km/h"),
    **dict.fromkeys(("mph", "mi/h", "miles/h"), "mph"),
    **dict.fromkeys(("m/s", "mps"), "m/s"),
}

LARGEST_FILE = 5_000_000  # characters; cantools takes 15 s and up to 1 GB for so much
LAST_BIT = 20_000  # J1939 carries 1785 bytes
MOST_SIGNALS = 2_000  # of one message: cantools compares each with each
MOST_PAGES = 5_000_000  # of multiplexed signals, which cantools lists one by one
MOST_BITS = 20_000_000  # of all messages or signals: those of 40 000 full frames of CAN FD

_COMMENT = re.compile(r"//[^\n]*\n?")
_MESSAGE = re.compile(r"\bBO_\s+\d+\s+\w+\s*:\s*(\d+)")
_BLOCK = re.compile(r"\bBO_\s")
_SIGNAL = re.compile(r"\bSG_\s")
_PLACE = re.compile(r":\s*(\d+)\s*\|\s*(\d+)")
_PAGES = re.compile(r"\bSG_MUL_VAL_\s+\d+([^;]*)")
_NUMBER = re.compile(r"\b\d+")


class DbcFile:
    """The DBC file that a profile names; not strict, because public files overlap and overhang."""

    def __init__(self, root: Section, path: Path) -> None:
        """Read it.

        Raises:
            InputError: no such file, or not one that cantools can read.
        """
        try:
            with TextIOWrapper(open_file(path), "cp1252", "replace") as file:
                self._text = file.read(LARGEST_FILE + 1)
        except OSError as error:
            raise root.error_at("dbc", f"{path}: {error.strerror}") from error
        if len(self._text) > LARGEST_FILE:
            raise root.error_at("dbc", f"{path}: larger than {LARGEST_FILE} bytes")
        if reason := _excess(self._text):
            raise root.error_at("dbc", f"{path}: not read: {reason}")
        try:
            database = cantools.database.load_string(
                self._text, database_format="dbc", strict=False
            )
        except Exception as error:
            # Errors of its own, of the parser, and whatever a broken file makes it stumble over.
            raise root.error_at("dbc", f"{path}: not a DBC file: {error}") from error
        self._messages = {str(message.name): message for message in database.messages}

    def message(self, section: Section) -> Any:
        """The `cantools.database.Message` that a section names.

        Raises:
            InputError: there is none, or its pages cannot be distinguished.
        """
        name = section.text("message")
        if name not in self._messages:
            reason = f"the DBC file has no message '{name}'{near_names(name, self._messages)}"
            raise section.error_at("message", reason)
        message = self._messages[name]
        if not message.is_multiplexed() and self._has_pages(name):
            # cantools then reads every page as if it were the only one.
            reason = f"message '{name}' is multiplexed, but no signal of it is the multiplexer 'M'"
            raise section.error_at("message", reason)
        if message.is_multiplexed() and (fault := _fault_of_pages(message)):
            raise section.error_at("message", f"{fault}; mend the DBC file")
        return message

    def _has_pages(self, name: str) -> bool:
        """True if a signal of a message is marked as one of a page: `SG_ Name m3 :`."""
        block = re.search(
            rf"^[ \t]*BO_\s+\d+\s+{re.escape(name)}\s*:.*\n((?:[ \t]*(?:SG_ .*)?\n)*)",
            f"{self._text}\n",
            re.M,
        )
        return bool(block and re.search(r"^[ \t]*SG_\s+\w+\s+m\d+\s*:", block[1], re.M))


def find_signal(section: Section, key: str, message: Any) -> Any:
    """The `cantools.database.Signal` of a message that `key` names.

    Raises:
        InputError: there is none, it is a floating-point number, or not within the message.
    """
    name = section.text(key)
    names = [str(signal.name) for signal in message.signals]
    if name not in names:
        reason = f"message '{message.name}' of the DBC file has no signal '{name}'"
        raise section.error_at(key, reason + near_names(name, names))
    signal = message.get_signal_by_name(name)
    if signal.is_float:
        raise section.error_at(key, f"'{name}' is a floating-point signal; only integers are read")
    if _hangs_over(signal, message):
        raise section.error_at(key, f"{_overhang(signal, message)}; mend the DBC file")
    return signal


def _fault_of_pages(message: Any) -> str | None:
    """Reason why cantools, which reads a page as a whole, would misread a multiplexed message."""
    for signal in message.signals:
        if _hangs_over(signal, message):
            return _overhang(signal, message)
    places = {signal.name: place_of(signal) for signal in message.signals}
    for one, other in combinations(places, 2):
        if places[one].overlaps(places[other]):
            return f"'{one}' and '{other}' overlap in message '{message.name}'"
    return None


def _hangs_over(signal: Any, message: Any) -> bool:
    return max(place_of(signal).bits) >= 8 * int(message.length)


def _overhang(signal: Any, message: Any) -> str:
    return f"'{signal.name}' hangs over the {message.length} bytes of message '{message.name}'"


def refuse_other_unit(section: Section, signal: Any) -> None:
    """Raise when profile and DBC file name different units of speed, and no scale says why."""
    stated = _SPEED_UNITS.get(str(signal.unit or "").strip().lower())
    if stated and stated != section.text("unit") and not section.has("scale"):
        reason = (
            f"the DBC file gives '{signal.name}' in {signal.unit}; if it is wrong, say scale: 1"
        )
        raise section.error_at("unit", reason)


class Place(NamedTuple):
    """Place in the payloads of a message."""

    bits: frozenset[int]  # bit 0 is the lowest of byte 0
    pages: frozenset[int] = frozenset()  # of a multiplexed message that have it; empty for all

    def overlaps(self, other: Place) -> bool:
        """True if one frame can hold both, and one bit is of both."""
        other_page = self.pages and other.pages and not self.pages & other.pages
        return bool(self.bits & other.bits) and not other_page


def place_of(signal: Any) -> Place:
    """The place of a `cantools.database.Signal`."""
    pages = frozenset(signal.multiplexer_ids or ())
    if signal.byte_order == "little_endian":
        return Place(frozenset(range(signal.start, signal.start + signal.length)), pages)
    # Motorola counts on from the highest bit of a byte to its lowest, then to the next byte.
    first = signal.start ^ 7
    return Place(frozenset(bit ^ 7 for bit in range(first, first + signal.length)), pages)


def _excess(text: str) -> str | None:
    """The too large part in the text of a DBC file; None when nothing is.

    cantools lays out every bit and page that it claims.
    """
    # What looks like a comment may be the inside of a string, and the other way round.
    return next(_excesses(text), None) or next(_excesses(_COMMENT.sub(" ", text)), None)


def _excesses(text: str) -> Iterator[str]:
    places = [_whole(number) for match in _PLACE.finditer(text) for number in match.groups()]
    if max(places, default=0) > LAST_BIT or sum(places) > MOST_BITS:
        yield f"a signal lies beyond bit {LAST_BIT}, or too many are long"
    lengths = [8 * _whole(match[1]) for match in _MESSAGE.finditer(text)]
    if max(lengths, default=0) > LAST_BIT or sum(lengths) > MOST_BITS:
        yield "a message, or all of them, are too long"
    signals = (sum(1 for _ in _SIGNAL.finditer(block)) for block in _BLOCK.split(text))
    if max(signals) > MOST_SIGNALS:
        yield f"a message has more than {MOST_SIGNALS} signals"
    statements = (match[1] for match in _PAGES.finditer(text))
    if sum(_whole(n[0]) for each in statements for n in _NUMBER.finditer(each)) > MOST_PAGES:
        yield "its multiplexed signals have too many pages"


def _whole(digits: str) -> int:
    """The number; Python would take its time with a very long one."""
    return int(digits) if len(digits) < 20 else 10**20
