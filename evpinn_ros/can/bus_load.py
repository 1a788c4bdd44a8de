"""Share of a bus that the frames on it take."""

from __future__ import annotations

STANDARD_BITS, EXTENDED_BITS = 34, 54
"""Bits of a data frame before its data and of its checksum, which stuffing applies to."""
FIXED_BITS = 13  # delimiters, acknowledgement, end of frame and the pause after it: never stuffed
STUFF_EVERY = 4  # bits, at worst


def frame_bits(length: int, extended: bool) -> tuple[int, int]:
    """Bits that a classic CAN data frame takes, without stuffing and with the most of it.

    Davis, Burns, Bril, Lukkien: "Controller Area Network (CAN) schedulability analysis: refuted,
    revisited and revised", Real-Time Systems 35, 2007, eq. 1.
    """
    stuffed = (EXTENDED_BITS if extended else STANDARD_BITS) + 8 * length
    return stuffed + FIXED_BITS, stuffed + FIXED_BITS + (stuffed - 1) // STUFF_EVERY
