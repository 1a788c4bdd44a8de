"""Finds the messages and signals that a profile names in its DBC file."""

from __future__ import annotations

from collections.abc import Mapping
from io import StringIO, TextIOWrapper
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

LARGEST_FILE = 5_000_000  # characters
# Limits of one message, of which cantools lays out every bit and page:
LARGEST_MESSAGE = 500_000  # characters
LAST_BIT = 20_000  # J1939 carries 1785 bytes
MOST_SIGNALS = 2_000  # cantools compares each signal with each
MOST_PAGES = 5_000_000  # of multiplexed signals, which cantools lists one by one
MOST_BITS = 20_000_000  # bits of all signals together

_CLOSING = {'"': re.compile(r'(?<!\\)"'), "//": re.compile(r"$", re.M)}
_OPENING = re.compile('"|//')
_MESSAGE = re.compile(r"\bBO_\s+(\d+)\s+(\w+)\s*:\s*(\d+)")
_STATEMENT = re.compile(
    r"\b(?:BO_|BO_TX_BU_|BU_|BU_SG_REL_|BU_EV_REL_|BU_BO_REL_|BA_|BA_DEF_|BA_DEF_DEF_|BA_REL_|"
    r"BA_DEF_REL_|BA_DEF_DEF_REL_|CM_|EV_|ENVVAR_DATA_|SGTYPE_|SIG_GROUP_|SIG_TYPE_REF_|"
    r"SIG_VALTYPE_|SG_MUL_VAL_|VAL_|VAL_TABLE_)\b"
)
_SIGNAL = re.compile(r"\bSG_\s")
_PLACE = re.compile(r":\s*(\d+)\s*\|\s*(\d+)")
_PAGED = re.compile(r"\bSG_\s+\w+\s+m\d+\s*:")
_PAGES = re.compile(r"\bSG_MUL_VAL_\s+\d+([^;]*)")
_NUMBER = re.compile(r"\b\d+")


class DbcFile:
    """The DBC file that a profile names, parsed leniently.

    cantools gets the text of one message only: a file of 5 MB would take it 10 s and 700 MB.
    """

    def __init__(self, root: Section, path: Path) -> None:
        """Read the file; InputError if it is missing or has no message."""
        try:
            with TextIOWrapper(open_file(path), "cp1252", "replace") as file:
                self._text = file.read(LARGEST_FILE + 1)
        except OSError as error:
            raise root.error_at("dbc", f"{path}: {error.strerror}") from error
        if len(self._text) > LARGEST_FILE:
            raise root.error_at("dbc", f"{path}: larger than {LARGEST_FILE} bytes")
        self._path, self._bare = path, _bare(self._text)
        self._messages = {match[2]: match for match in _MESSAGE.finditer(self._bare)}
        if not self._messages:
            raise root.error_at("dbc", f"{path}: not a DBC file: it has no message")

    def message(self, section: Section) -> Any:
        """The `cantools.database.Message` that a section names; InputError if none or invalid."""
        name = section.text("message")
        if name not in self._messages:
            reason = f"the DBC file has no message '{name}'{near_names(name, self._messages)}"
            raise section.error_at("message", reason)
        text, bare = self._cut(self._messages[name])
        if excess := _excess(text) or _excess(bare):
            raise section.error_at("message", f"'{name}' is not read: {excess}")
        try:
            (message,) = cantools.database.load_string(text, "dbc", strict=False).messages
        except Exception as error:
            # cantools raises errors of its own, of its parser, and any other for a broken file.
            reason = f"{self._path}: message '{name}' cannot be read: {error}"
            raise section.error_at("message", reason) from error
        if not message.is_multiplexed() and _PAGED.search(bare):
            # cantools would then read every page as if it were the only one.
            reason = f"message '{name}' is multiplexed, but no signal of it is the multiplexer 'M'"
            raise section.error_at("message", reason)
        if message.is_multiplexed() and (fault := _fault_of_pages(message)):
            raise section.error_at("message", f"{fault}; correct the DBC file")
        return message

    def _cut(self, start: re.Match[str]) -> tuple[str, str]:
        """Text of one message's layout in the file, with and without its strings."""
        after = _STATEMENT.search(self._bare, start.end())
        parts = [slice(start.start(), after.start() if after else None)]
        of_message = rf"\b(?:SG_MUL_VAL_|SIG_VALTYPE_)\s+{start[1]}\b[^;]*;"
        parts += [slice(*match.span()) for match in re.finditer(of_message, self._bare)]
        return "\n".join(self._text[p] for p in parts), "\n".join(self._bare[p] for p in parts)


def _bare(text: str) -> str:
    """Text of a DBC file with strings and comments blanked, of the same length."""
    bare, place = StringIO(), 0
    while begin := _OPENING.search(text, place):
        end = _CLOSING[begin[0]].search(text, begin.end())
        bare.write(text[place : begin.start()])
        place = end.end() if end else len(text)
        bare.write(" " * (place - begin.start()))
    bare.write(text[place:])
    return bare.getvalue()


def find_signal(section: Section, key: str, message: Any) -> Any:
    """The `cantools.database.Signal` that `key` names; InputError if missing or invalid."""
    name = section.text(key)
    names = [str(signal.name) for signal in message.signals]
    if name not in names:
        reason = f"message '{message.name}' of the DBC file has no signal '{name}'"
        raise section.error_at(key, reason + near_names(name, names))
    signal = message.get_signal_by_name(name)
    if signal.is_float:
        raise section.error_at(key, f"'{name}' is a floating-point signal; only integers are read")
    if _hangs_over(signal, message):
        raise section.error_at(key, f"{_overhang(signal, message)}; correct the DBC file")
    return signal


def _fault_of_pages(message: Any) -> str | None:
    """Why cantools, which reads a page as a whole, would misread a multiplexed message."""
    for signal in message.signals:
        if _hangs_over(signal, message):
            return _overhang(signal, message)
    places = {signal.name: place_of(signal) for signal in message.signals}
    for first, other in combinations(places, 2):
        if places[first].overlaps(places[other]):
            return f"'{first}' and '{other}' overlap in message '{message.name}'"
    return None


def _hangs_over(signal: Any, message: Any) -> bool:
    return max(place_of(signal).bits) >= 8 * int(message.length)


def _overhang(signal: Any, message: Any) -> str:
    return f"'{signal.name}' exceeds the {message.length} bytes of message '{message.name}'"


def refuse_other_unit(section: Section, signal: Any) -> None:
    """Raise InputError if profile and DBC file differ in the unit of speed without a scale."""
    stated = _SPEED_UNITS.get(str(signal.unit or "").strip().lower())
    if stated and stated != section.text("unit") and not section.has("scale"):
        reason = (
            f"the DBC file gives '{signal.name}' in {signal.unit}; if that is wrong, add scale: 1"
        )
        raise section.error_at("unit", reason)


class Place(NamedTuple):
    """Bits and pages of a signal in the payloads of its message."""

    bits: frozenset[int]  # bit 0 is the lowest of byte 0
    pages: frozenset[int] = frozenset()  # multiplexed pages with the signal; empty: all

    def overlaps(self, other: Place) -> bool:
        """True if the two places share a bit in some frame."""
        other_page = self.pages and other.pages and not self.pages & other.pages
        return bool(self.bits & other.bits) and not other_page


def place_of(signal: Any) -> Place:
    """The place of a `cantools.database.Signal`."""
    pages = frozenset(signal.multiplexer_ids or ())
    if signal.byte_order == "little_endian":
        return Place(frozenset(range(signal.start, signal.start + signal.length)), pages)
    # Motorola signals run from the highest bit of a byte to its lowest, then to the next byte.
    first = signal.start ^ 7
    return Place(frozenset(bit ^ 7 for bit in range(first, first + signal.length)), pages)


def _excess(text: str) -> str | None:
    """The limit that the text of a message exceeds, in words; None if none."""
    if len(text) > LARGEST_MESSAGE:
        return f"it has more than {LARGEST_MESSAGE} characters"
    places = [_whole(number) for match in _PLACE.finditer(text) for number in match.groups()]
    if max(places, default=0) > LAST_BIT or sum(places) > MOST_BITS:
        return f"a signal lies beyond bit {LAST_BIT}, or its signals have too many bits"
    if any(8 * _whole(match[3]) > LAST_BIT for match in _MESSAGE.finditer(text)):
        return f"it has more than {LAST_BIT} bits"
    if sum(1 for _ in _SIGNAL.finditer(text)) > MOST_SIGNALS:
        return f"it has more than {MOST_SIGNALS} signals"
    statements = (match[1] for match in _PAGES.finditer(text))
    if (
        sum(_whole(n[0]) for statement in statements for n in _NUMBER.finditer(statement))
        > MOST_PAGES
    ):
        return "its multiplexed signals have too many pages"
    return None


def _whole(digits: str) -> int:
    return int(digits) if len(digits) < 20 else 10**20
