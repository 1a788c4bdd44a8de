"""Heights of the ground by place, from tiles of elevation that the user has.

A tile of SRTM (`N48E011.hgt`) holds one degree of latitude and longitude as big-endian 16-bit
metres, in rows from north to south, with the last row and column those of the next tile: 1201 x
1201 of three, or 3601 x 3601 of one arc second ("SRTM Topography", USGS).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
import math
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import open_unpacked
from evpinn_ros.signals.readings import AltitudeReading, Reading

_NAME = re.compile(r"([NS])(\d\d)([EW])(\d\d\d)\.hgt(?:\.gz)?", re.IGNORECASE)
_SIDES = (1201, 3601)  # samples
_VOID = -32768
TILES_KEPT = 16

FloatArray = NDArray[np.float64]


class Terrain:
    """Heights of the tiles in a folder."""

    def __init__(self, folder: Path) -> None:
        """Look for tiles; InputError where there is none."""
        self._paths: dict[tuple[int, int], Path] = {}
        with as_input_error(folder):
            for path in sorted(folder.iterdir()):
                if match := _NAME.fullmatch(path.name):
                    south = int(match[2]) * (1 if match[1].upper() == "N" else -1)
                    west = int(match[4]) * (1 if match[3].upper() == "E" else -1)
                    self._paths[south, west] = path
        if not self._paths:
            raise InputError(f"{folder}: no tile of elevation, as N48E011.hgt or N48E011.hgt.gz")
        self._tile = lru_cache(TILES_KEPT)(_read)

    def heights(self, latitude: FloatArray, longitude: FloatArray) -> FloatArray:
        """Heights at n places, m, NaN where no tile has one; shape (n,) like the degrees given.

        Raises:
            InputError: a tile cannot be read.
        """
        found = np.full(latitude.shape, np.nan)
        known = np.isfinite(latitude) & np.isfinite(longitude)
        corners = np.floor(np.column_stack((latitude, longitude))[known]).astype(int)
        for south, west in np.unique(corners, axis=0).tolist():
            path = self._paths.get((south, west))
            if path is None:
                continue
            here = known & (np.floor(latitude) == south) & (np.floor(longitude) == west)
            found[here] = _between(
                self._tile(path), latitude[here] - south, longitude[here] - west
            )
        return found

    def on(self, readings: Iterator[Reading]) -> Iterator[Reading]:
        """Readings whose altitudes are those of the ground at their place, where that is known."""
        for reading in readings:
            if isinstance(reading, AltitudeReading):
                place = np.array([reading.latitude]), np.array([reading.longitude])
                height = float(self.heights(*place)[0])
                yield reading if math.isnan(height) else replace(reading, altitude=height)
            else:
                yield reading


def _read(path: Path) -> NDArray[np.int16]:
    with as_input_error(path, EOFError), open_unpacked(path) as file:
        data = file.read(2 * max(_SIDES) ** 2 + 1)
    side = math.isqrt(len(data) // 2)
    if side not in _SIDES or 2 * side**2 != len(data):
        raise InputError(f"{path}: no tile of 1201 x 1201 or 3601 x 3601 heights")
    return np.frombuffer(data, ">i2").reshape(side, side)


def _between(tile: NDArray[np.int16], north: FloatArray, east: FloatArray) -> FloatArray:
    """Bilinear heights at parts of a degree from the south and the west, shape (n,)."""
    last = len(tile) - 1
    row, column = (1.0 - north) * last, east * last
    i, j = (np.minimum(each.astype(int), last - 1) for each in (row, column))
    down, right = row - i, column - j
    corners = np.array([tile[i, j], tile[i, j + 1], tile[i + 1, j], tile[i + 1, j + 1]], float)
    corners[corners == _VOID] = np.nan
    weights = np.array([(1 - down) * (1 - right), (1 - down) * right, down * (1 - right)])
    return np.asarray((np.vstack((weights, down * right)) * corners).sum(0))
