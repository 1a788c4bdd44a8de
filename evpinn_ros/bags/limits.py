"""Limits on the size of a bag, whatever its own lengths claim; each stands here alone.

What a small file can unpack to is bounded by its own size, so that work and memory are too.
"""

from __future__ import annotations

from evpinn_ros.common.units import MEBIBYTE

LONGEST_CHUNK = 128 * MEBIBYTE
"""Bytes of a chunk, packed and unpacked, of a message in it and of an attachment. Recorders write
chunks of 1 MB, and a longer message has one of its own."""

LONGEST_MESSAGE = 16 * MEBIBYTE
"""Bytes of a message that is decoded: ours have at most 8 MB, a plan of 50 000 points."""

LARGEST_SUMMARY = 64 * MEBIBYTE
"""Bytes of the end of an MCAP file, that of 500 000 chunks; with a larger one its index is not
used."""

MOST_DEFINITIONS = 64 * MEBIBYTE
"""Bytes of all schemas and channels of a file together."""

MOST_HELD = 64 * MEBIBYTE
"""Bytes of messages held back to put them in order. Chunks of a recorder overlap by seconds."""
