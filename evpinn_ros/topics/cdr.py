"""Messages as the bytes they travel in: plain CDR, as every ROS 2 middleware sends it.

rclpy makes Python objects of every point of a plan, which takes many times as long as its
forecast. Here the points stay bytes, and one number of all of them becomes one array.
"""

from __future__ import annotations

from collections.abc import Callable
import struct

import numpy as np

ENCAPSULATION = b"\x00\x01\x00\x00"  # plain CDR, little endian, no options
WIDEST = 8  # bytes, the largest alignment


class CdrError(ValueError):
    """Bytes are no such message."""


class CdrReader:
    """Walks along a message; offsets count from behind its encapsulation, as alignment does."""

    def __init__(self, data: bytes) -> None:
        """Begin at the first field.

        Raises:
            CdrError: it is no plain CDR.
        """
        if len(data) < len(ENCAPSULATION) or data[0] != 0 or data[1] > 1:
            raise CdrError("the message is no plain CDR")
        self._order = "<" if data[1] else ">"
        self._body = np.frombuffer(data, np.uint8, offset=len(ENCAPSULATION))
        self._at = 0

    def take(self, size: int, alignment: int) -> int:
        """Step over so many bytes; gives the offset at which they begin.

        Raises:
            CdrError: the message ends before.
        """
        begin = -(-self._at // alignment) * alignment
        if begin + size > self._body.size:
            raise CdrError("the message is cut short")
        self._at = begin + size
        return begin

    def number(self, kind: str = "I") -> int:
        """A whole number of four bytes, `I` or `i` as in `struct`."""
        found: int = struct.unpack_from(self._order + kind, self._body.data, self.take(4, 4))[0]
        return found

    def sequence(self, size: int) -> tuple[int, int]:
        """Step over a sequence of items of a size; gives the offsets of its length and of them."""
        length = self.number()
        return self._at - 4, self.take(length * size, size if length else 1)

    def text(self) -> str:
        """A text."""
        _, begin = self.sequence(1)
        return bytes(self._body[begin : self._at]).rstrip(b"\0").decode(errors="replace")

    def elements(
        self, count: int, walk: Callable[[CdrReader], tuple[int, ...]], lengths: int
    ) -> np.ndarray:
        """Step over the elements of a sequence.

        Where all are laid out alike, as nearly always, two of them tell where the others are.

        Args:
            count: of the elements, at least 1.
            walk: steps over one; gives offsets in it, those of the lengths of its sequences first.
            lengths: how many of the offsets are such.

        Returns:
            The offsets, shape (count, offsets).

        Raises:
            CdrError: the message ends before.
        """
        rows = [walk(self)]
        if count > 2:
            before = self._at
            rows.append(walk(self))
            stride = self._at - before
            alike = np.array(rows[1]) + stride * np.arange(count - 1)[:, None]
            end = before + stride * (count - 1)
            if end <= self._body.size and stride % WIDEST == 0:
                found = [self.numbers(column, "u4") for column in alike.T[:lengths]]
                if all((each == each[0]).all() for each in found):
                    self._at = end
                    return np.concatenate((np.array(rows[:1]), alike))
        rows += [walk(self) for _ in range(count - len(rows))]
        return np.array(rows)

    def numbers(self, offsets: np.ndarray, kind: str) -> np.ndarray:
        """The numbers at offsets, shape (n,); their kind is `u4`, `i4` or `f8` as in numpy."""
        dtype = np.dtype(self._order + kind)
        found: np.ndarray = self._body[offsets[:, None] + np.arange(dtype.itemsize)].view(dtype)
        return found[:, 0]


def cdr_text(text: str) -> bytes:
    """A text, padded so that a number of four bytes may follow."""
    content = text.encode() + b"\0"
    return struct.pack("<I", len(content)) + content + b"\0" * (-len(content) % 4)
