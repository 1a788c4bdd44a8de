"""Heights of the ground by position, from tiles of the user: SRTM or GeoTIFF.

`N48E011.hgt` holds one by one degree as big-endian 16-bit metres, rows from north to south, with
shared edges: 1201 x 1201 at three arc seconds, 3601 x 3601 at one ("SRTM Topography", USGS). GDAL
reads GeoTIFF in another process.
"""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache
import math
from pathlib import Path
import re
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import open_file, open_unpacked
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.sandbox import run_apart
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import AltitudeReading
from evpinn_ros.logs.signal import FloatArray

with suppress(ImportError):  # imported first, since limits of the process count from then on
    import rasterio  # noqa: F401

_NAME = re.compile(r"([NS])(\d\d)([EW])(\d\d\d)\.hgt(?:\.gz)?", re.IGNORECASE)
_GEOTIFF = (".tif", ".tiff")
TILES_KEPT = 16
_SIDES = (1201, 3601)  # samples per side
_VOID = -32768
MOST_HEIGHTS = 200_000_000  # samples of a GeoTIFF: 14 000 x 14 000


class Terrain:
    """Heights of the tiles in a folder."""

    def __init__(self, folder: Path) -> None:
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
                f"{folder}: no tile of elevation, such as N48E011.hgt, N48E011.hgt.gz or a GeoTIFF"
            )
        if tiffs:
            with optional_imports():
                import rasterio  # noqa: F401
        with TemporaryDirectory() as kept:  # the grids are mapped, so their files may be deleted
            self._grids = [read_geotiff(path, Path(kept)) for path in tiffs]

    def heights(self, latitude: FloatArray, longitude: FloatArray) -> FloatArray:
        """Heights at n positions in degrees, m, NaN without a tile; InputError if damaged."""
        heights = np.full(latitude.shape, np.nan)
        placed = np.isfinite(latitude) & np.isfinite(longitude)
        corners = np.floor(np.column_stack((latitude, longitude))[placed]).astype(int)
        for south, west in np.unique(corners, axis=0).tolist():
            path = self._paths.get((south, west))
            if path is None:
                continue
            here = placed & (np.floor(latitude) == south) & (np.floor(longitude) == west)
            heights[here] = self._hgt(path, south, west).at(latitude[here], longitude[here])
        for grid in self._grids:
            left = placed & np.isnan(heights)
            heights[left] = grid.at(latitude[left], longitude[left])
        return heights

    def over(self, block: Block) -> Block:
        """The block with altitudes of the ground at its positions, where known."""
        rows = block.of_kind(AltitudeReading)
        if not len(rows.order):
            return block
        altitude, *place = rows.values
        ground = self.heights(*place)
        altitude = np.where(np.isnan(ground), altitude, ground)
        return block.with_rows(AltitudeReading, rows._replace(values=np.array([altitude, *place])))


class HeightGrid(NamedTuple):
    """Heights on a grid of latitudes and longitudes."""

    heights: NDArray[np.generic]  # m, north to south and west to east; NaN or `_VOID` if unknown
    north: float  # latitude of the first row, degrees
    west: float  # longitude of the first column, degrees
    steps: tuple[float, float]  # between rows and between columns, degrees, both positive

    def at(self, latitude: FloatArray, longitude: FloatArray) -> FloatArray:
        """Bilinear heights at n positions, m, or NaN; cells reach half a step beyond samples."""
        heights = np.full(latitude.shape, np.nan)
        rows, columns = self.heights.shape
        row, column = (
            (self.north - latitude) / self.steps[0],
            (longitude - self.west) / self.steps[1],
        )
        inside = (row >= -0.5) & (row <= rows - 0.5) & (column >= -0.5) & (column <= columns - 0.5)
        row = np.clip(row[inside], 0, rows - 1)
        column = np.clip(column[inside], 0, columns - 1)
        i, j = np.minimum(row.astype(int), rows - 2), np.minimum(column.astype(int), columns - 2)
        down, right = row - i, column - j
        corners = [self.heights[i + m, j + n].astype(float) for m in (0, 1) for n in (0, 1)]
        values = np.array(corners)
        values[values == _VOID] = np.nan
        weights = np.array([(1 - down) * (1 - right), (1 - down) * right, down * (1 - right)])
        heights[inside] = (np.vstack((weights, down * right)) * values).sum(0)
        return heights


def read_hgt(path: Path, south: int, west: int) -> HeightGrid:
    """Heights of the SRTM tile with this corner, degrees; InputError if it is invalid."""
    with as_input_error(path, EOFError), open_unpacked(path) as file:
        data = file.read(2 * max(_SIDES) ** 2 + 1)
    side = math.isqrt(len(data) // 2)
    if side not in _SIDES or 2 * side**2 != len(data):
        raise InputError(f"{path}: no tile of 1201 x 1201 or 3601 x 3601 heights")
    step = 1.0 / (side - 1)
    heights = np.frombuffer(data, ">i2").reshape(side, side)
    return HeightGrid(heights, south + 1.0, float(west), (step, step))


def read_geotiff(path: Path, folder: Path) -> HeightGrid:
    """Heights of a GeoTIFF, mapped from a file that is written to the folder; InputError."""
    heights, place = folder / f"{path.name}.npy", folder / f"{path.name}.place.npy"
    if failed := run_apart(f"{__name__}:write_grid", path, heights):
        raise InputError(f"{path}: {failed}")
    with open_file(place) as file:
        north, west, *steps = np.load(file).tolist()
    return HeightGrid(np.load(heights, mmap_mode="r"), north, west, (steps[0], steps[1]))


def write_grid(path: Path, out: Path) -> None:
    """Write the first band of a GeoTIFF as heights by latitude and longitude, and its place."""
    from rasterio import open as open_raster
    from rasterio.enums import Resampling
    from rasterio.vrt import WarpedVRT

    with open_raster(path, driver="GTiff") as file:
        if file.crs is None:
            raise InputError("no coordinate system in it")
        floats = {"dtype": "float32", "nodata": math.nan, "resampling": Resampling.bilinear}
        with WarpedVRT(file, crs="EPSG:4326", **floats) as grid:
            if grid.width * grid.height > MOST_HEIGHTS or min(grid.shape) < 2:
                size = f"{grid.width} x {grid.height} heights"
                raise InputError(f"{size}; 2 x 2 to {MOST_HEIGHTS} in all are read")
            heights = grid.read(1)
            corner = grid.transform  # of the first cell; its height is that of its centre
    place = corner.f + corner.e / 2, corner.c + corner.a / 2, -corner.e, corner.a
    np.save(out, heights)
    np.save(out.with_suffix(".place.npy"), np.array(place))
