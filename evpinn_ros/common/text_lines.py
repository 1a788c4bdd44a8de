"""Lines of text files from anywhere: one without an end would fill the memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO

LONGEST_LINE = 1_000_000  # characters: a frame of CAN FD takes 200, a row of a wide table 10 000


def bounded_lines(file: IO[str]) -> Iterator[str]:
    """The lines of a file, each with its end.

    Raises:
        ValueError: a line is longer than `LONGEST_LINE`.
    """
    while line := file.readline(LONGEST_LINE + 1):
        if len(line) > LONGEST_LINE:
            raise ValueError(f"a line is longer than {LONGEST_LINE} characters")
        yield line
