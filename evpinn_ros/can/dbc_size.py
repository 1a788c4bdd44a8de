"""Limit on what a DBC file expands to: cantools lays out every bit and page it claims."""

from __future__ import annotations

from collections.abc import Iterator
import re

LARGEST_FILE = 5_000_000  # characters; cantools takes 15 s and up to 1 GB for so much
LAST_BIT = 20_000  # J1939 carries 1785 bytes
MOST_SIGNALS = 2_000  # of one message: cantools compares each with each
MOST_PAGES = 5_000_000  # of multiplexed signals, which cantools lists one by one
MOST_BITS = 20_000_000  # of all messages or signals: those of 40 000 full frames of CAN FD

_COMMENT = re.compile(r"//.*?\n", re.S)
_MESSAGE = re.compile(r"\bBO_\s+\d+\s+\w+\s*:\s*(\d+)")
_BLOCK = re.compile(r"\bBO_\s")
_SIGNAL = re.compile(r"\bSG_\s")
_PLACE = re.compile(r":\s*(\d+)\s*\|\s*(\d+)")
_PAGES = re.compile(r"\bSG_MUL_VAL_\s+\d+([^;]*)")
_NUMBER = re.compile(r"\b\d+")


def excess(text: str) -> str | None:
    """Name the too large part in the text of a DBC file; None when nothing is."""
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
