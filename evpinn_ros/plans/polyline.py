"""Encoded polylines, which route services send in place of lists of places."""

from __future__ import annotations

import numpy as np

from evpinn_ros.energy.plan import MAX_POINTS, PlanError

LONGEST = 16 * MAX_POINTS  # characters; a point takes four to twelve
MOST_CHUNKS = 7  # characters of a number: 35 bits, of which places need 29


def decode_polyline(text: str, scale: float, dimensions: int) -> np.ndarray:
    """Latitude, longitude and, of three dimensions, height of n points; shape (n, dimensions).

    The algorithm is Google's (developers.google.com/maps/documentation/utilities, "Encoded
    Polyline Algorithm Format"); GraphHopper and openrouteservice add height, in 0.01 m.

    Args:
        text: the polyline.
        scale: numbers in a degree, 1e5 or 1e6.
        dimensions: 2, or 3 with heights.

    Raises:
        PlanError: it is damaged.
    """
    if len(text) > LONGEST:
        raise PlanError(f"a polyline of more than {LONGEST} characters")
    codes = np.frombuffer(text.encode("latin-1", "replace"), np.uint8).astype(np.int64) - 63
    ends = np.flatnonzero(codes < 32)
    starts = np.concatenate(([0], ends[:-1] + 1))
    lengths = ends - starts + 1
    valid = len(ends) > 0 and len(ends) % dimensions == 0 and ends[-1] == len(codes) - 1
    if not valid or codes.min() < 0 or codes.max() > 63 or lengths.max() > MOST_CHUNKS:
        raise PlanError("its polyline is damaged")
    shifts = 5 * (np.arange(len(codes)) - np.repeat(starts, lengths))
    numbers = np.add.reduceat((codes & 31) << shifts, starts)
    steps = np.where(numbers & 1, ~(numbers >> 1), numbers >> 1)
    places = steps.reshape(-1, dimensions).cumsum(axis=0)
    found: np.ndarray = places / np.array([scale, scale, 100.0])[:dimensions]
    return found
