"""The one error a person can mend: wrong input, in one line."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches

LONGEST_TEXT = 1000  # characters: what is shown may be quoted from a file, which may hold anything


class InputError(Exception):
    """A file, message or setting given by a person is wrong.

    The text names the file (and line, where there is one) and the reason in one line; commands
    print it as it is and exit with code 1.
    """

    def __str__(self) -> str:
        return printable(super().__str__())


@contextmanager
def as_input_error(what: object = None, *kinds: type[Exception]) -> Iterator[None]:
    """Say in one line, after `what` or else the error's file, what failed in a block."""
    caught: tuple[type[Exception], ...] = (OSError, *kinds)
    try:
        yield
    except caught as error:
        begin = getattr(error, "filename", None) if what is None else what
        raise InputError(f"{begin}: {reason_of(error)}") from error


def reason_of(error: BaseException) -> str:
    """Reason of an error in one line: that of the system without its number and file."""
    return getattr(error, "strerror", None) or one_line(error)


def one_line(error: BaseException) -> str:
    """Text of an error of foreign code in one line; its kind where it has no text."""
    return " ".join(str(error).split()) or type(error).__name__


def with_kind(error: BaseException) -> str:
    """Text of an error in one line, with its kind unless a person can mend it."""
    text = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
    return " ".join(text.split())


def printable(text: str) -> str:
    """One line of a text, without what would speak to the terminal, and of bearable length."""
    shown = "".join(character if character.isprintable() else " " for character in text)
    return shown if len(shown) <= LONGEST_TEXT else shown[:LONGEST_TEXT] + "..."


# Of a recording of several cars; a command of fleets does not have the option.
SAY_CAR = "say --car NAME for one of them, or use what evpinn convert --car NAME writes"


def near_names(name: str, known: Iterable[str]) -> str:
    """Words to append to an error: known names near to what was typed, empty if none is."""
    by_lower = {name_known.lower(): name_known for name_known in known}
    near = [by_lower[lower] for lower in get_close_matches(name.lower(), by_lower, cutoff=0.6)]
    return f"; did you mean {', '.join(near)}" if near else ""


def known_names(name: str, known: Collection[str]) -> str:
    """Names near to a wrong one, then all that are known."""
    return f"{near_names(name, known)}; known are {', '.join(known)}"
