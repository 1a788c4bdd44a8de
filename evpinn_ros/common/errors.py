"""`InputError`, for everything that a person can correct, and one-line texts of errors."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches

LONGEST_TEXT = 1000  # characters: the text may quote a file of any content


class InputError(Exception):
    """A file, message or setting given by a person is wrong.

    The text names the file (and line, where there is one) and the reason in one line; commands
    print it as it is and exit with code 1.
    """

    def __str__(self) -> str:
        return printable(super().__str__())


@contextmanager
def as_input_error(what: object = None, *kinds: type[Exception]) -> Iterator[None]:
    """Turn OSError and `kinds` in a block into InputError, which names `what`, else the file."""
    caught: tuple[type[Exception], ...] = (OSError, *kinds)
    try:
        yield
    except caught as error:
        name = getattr(error, "filename", None) if what is None else what
        raise InputError(f"{name}: {reason_of(error)}") from error


def reason_of(error: BaseException) -> str:
    """Reason of an error in one line; an OSError without its number and file."""
    return getattr(error, "strerror", None) or one_line(error)


def one_line(error: BaseException) -> str:
    """Text of an error of foreign code in one line, or its class name if it has no text."""
    return " ".join(str(error).split()) or type(error).__name__


def with_kind(error: BaseException) -> str:
    """Text of an error in one line, with its class name unless it is an InputError."""
    text = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
    return " ".join(text.split())


def printable(text: str) -> str:
    """A text as one line without control characters, cut to `LONGEST_TEXT`."""
    shown = "".join(character if character.isprintable() else " " for character in text)
    return shown if len(shown) <= LONGEST_TEXT else shown[:LONGEST_TEXT] + "..."


# Appended to the error for a recording of several cars; `evpinn fleet` has no --car.
SAY_CAR = "say --car NAME for one of them, or use what evpinn convert --car NAME writes"


def near_names(name: str, known: Iterable[str]) -> str:
    """Text to append to an error: known names similar to `name`; empty if there are none."""
    by_lower = {name_known.lower(): name_known for name_known in known}
    near = [by_lower[lower] for lower in get_close_matches(name.lower(), by_lower, cutoff=0.6)]
    return f"; did you mean {', '.join(near)}" if near else ""


def known_names(name: str, known: Collection[str]) -> str:
    """Text to append to an error: similar names, then all known names."""
    return f"{near_names(name, known)}; known are {', '.join(known)}"
