"""Heights of the ground by place, from tiles of elevation that the user has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
import math
from pathlib import Path
import re
from tempfile import TemporaryDirectory

import numpy as np

from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.drives.elevation_tiles import FloatArray, read_geotiff, read_hgt
from evpinn_ros.signals.readings import AltitudeReading, Reading

_NAME = re.compile(r"([NS])(\d\d)([EW])(\d\d\d)\.hgt(?:\.gz)?", re.IGNORECASE)
_GEOTIFF = (".tif", ".tiff")
TILES_KEPT = 16


class Terrain:
    """Heights of the tiles in a folder."""

    def __init__(self, folder: Path) -> None:
        """Look for tiles; InputError where there is none, or a GeoTIFF cannot be read."""
        self._paths: dict[tuple[int, int], Path] = {}
        with as_input_error(folder):
            paths = sorted(folder.iterdir())
        for path in paths:
            if match := _NAME.fullmatch(path.name):
                south = int(match[2]) * (1 if match[1].upper() == "N" else -1)
                west = int(match[4]) * (1 if match[3].upper() == "E" else -1)
                self._paths[south, west] = path
        self._hgt = lru_cache(TILES_KEPT)(read_hgt)
        tiffs = [path for path in paths if path.suffix.lower() in _GEOTIFF]
        if not self._paths and not tiffs:
            raise InputError(
                f"{folder}: no tile of elevation, as N48E011.hgt, N48E011.hgt.gz or a GeoTIFF"
            )
        if tiffs and find_spec("rasterio") is None:
            raise InputError(
                f"{tiffs[0]}: a GeoTIFF needs rasterio: pip install 'evpinn_ros[elevation]'"
            )
        self._folder = TemporaryDirectory()  # lasts as long as the grids
        self._grids = [read_geotiff(path, Path(self._folder.name)) for path in tiffs]

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
            found[here] = self._hgt(path, south, west).at(latitude[here], longitude[here])
        for grid in self._grids:
            left = known & np.isnan(found)
            found[left] = grid.at(latitude[left], longitude[left])
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
