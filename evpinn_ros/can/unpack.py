"""Raw bits of the signals that are asked for, read from the payload as one number.

cantools reads every signal of a message; a profile wants two or three, and wants them thousands of
times a second. The numbers are those of cantools, which still reads what depends on other bits.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

Unpack = Callable[[bytes], dict[str, int]]
"""From a payload to the raw bits by name, of those signals that lie in it whole."""


def unpacker(message: Any, names: Collection[str]) -> Unpack:
    """Reader of some signals of a `cantools.database.Message`.

    Bits beyond the message's length are not looked at. A multiplexed message is left to cantools,
    whose exceptions then come through, and so is one with a wanted signal of floating point or
    one that hangs over the message's end.
    """
    fields = [_Field(message.get_signal_by_name(name)) for name in names]
    bits = 8 * message.length
    if message.is_multiplexed() or any(field.is_float or field.end > bits for field in fields):
        return lambda data: dict(
            message.decode(data, decode_choices=False, scaling=False, allow_truncated=True)
        )
    little = [(each.name, each.end, each.start, each.mask, each.sign) for each in fields
              if each.is_little]  # fmt: skip
    big = [(each.name, each.end, each.mask, each.sign) for each in fields if not each.is_little]

    def unpack(data: bytes) -> dict[str, int]:
        size, raw = 8 * len(data), {}
        if little:
            word = int.from_bytes(data, "little")
            for name, end, start, mask, sign in little:
                if end <= size:
                    raw[name] = ((word >> start & mask) ^ sign) - sign
        if big:
            word = int.from_bytes(data, "big")
            for name, end, mask, sign in big:
                if end <= size:
                    raw[name] = ((word >> size - end & mask) ^ sign) - sign
        return raw

    return unpack


class _Field:
    """Place of a signal. Bits count from the payload's start, in the signal's byte order.

    Motorola signals (big endian) count the highest bit of a byte first; a DBC names their first
    bit by its place within the byte all the same, bit 7 of byte 0 being the very first.
    """

    def __init__(self, signal: Any) -> None:
        self.name, self.is_float = str(signal.name), bool(signal.is_float)
        self.is_little = signal.byte_order == "little_endian"
        self.start = int(signal.start if self.is_little else signal.start ^ 7)
        self.end = self.start + int(signal.length)
        self.mask = (1 << signal.length) - 1
        # Two's complement: (x ^ sign) - sign is x below the sign bit, x - 2 sign from it on.
        self.sign = 1 << signal.length - 1 if signal.is_signed else 0
