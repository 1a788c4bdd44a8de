"""Heights by place from tiles of elevation, between their samples and over their edges."""

import gzip
import json
import math
import tempfile

import numpy as np
import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import AltitudeReading
from evpinn_ros.logs.plans import read_plan
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.sources import open_drive
from evpinn_ros.logs.terrain import Terrain

SIDE = 1201


def plane(latitude, longitude):
    """Ground that rises to the north and the east, m."""
    return 100.0 + 900.0 * (latitude - 48.0) + 300.0 * (longitude - 11.0)


@pytest.fixture
def tiles(tmp_path):
    """Two tiles beside each other, one of them packed; a void in the first."""
    folder = tmp_path / "tiles"
    folder.mkdir()
    for west in (11, 12):
        north_first = np.linspace(49.0, 48.0, SIDE)[:, None]
        heights = np.rint(plane(north_first, np.linspace(west, west + 1, SIDE))).astype(">i2")
        if west == 11:
            heights[0, 0] = -32768
            (folder / "N48E011.hgt").write_bytes(heights.tobytes())
        else:
            (folder / "n48e012.hgt.gz").write_bytes(gzip.compress(heights.tobytes(), 1))
    return folder


def test_heights_lie_between_the_samples_of_a_tile(tiles):
    rng = np.random.default_rng(0)
    latitude, longitude = 48.0 + 0.99 * rng.random(500), 11.0 + 2 * rng.random(500)
    heights = Terrain(tiles).heights(latitude, longitude)
    assert heights == pytest.approx(plane(latitude, longitude), abs=0.8)  # whole metres


def test_where_no_tile_has_a_height_there_is_none(tiles):
    places = np.array([48.9999, 49.5, 48.5, np.nan]), np.array([11.0001, 11.5, -11.5, 11.5])
    assert np.isnan(Terrain(tiles).heights(*places)).all(), "a void, and beyond the tiles"


def heights_of_a_log(folder, rows, terrain, header="t_s,speed_mps,power_w,latitude,longitude"):
    (folder / "drive.csv").write_text("\n".join([header, *rows]) + "\n")
    log = open_drive(folder / "drive.csv", options=ReadOptions(terrain=terrain))
    return [r.altitude for r in log.readings() if isinstance(r, AltitudeReading)]


def test_a_track_of_a_plan_lies_on_the_ground(tmp_path, tiles):
    """Its heights alone were assumed to be unknown, without a word about the tiles."""
    line = [[11.5, 48.2 + 1e-3 * i] for i in range(60)]
    content = {"type": "LineString", "coordinates": line}
    (tmp_path / "route.geojson").write_text(json.dumps(content))
    options = ReadOptions(terrain=Terrain(tiles), pace=20.0)
    legs = read_plan(tmp_path / "route.geojson", options=options)
    assert legs.height_known.all()
    assert legs.climb.sum() == pytest.approx(900.0 * 0.059, abs=1.5)  # smoothed, whole metres
    (tmp_path / "legs.csv").write_text("length_km,speed_kmh\n1,72\n")
    with pytest.warns(UserWarning, match="tiles of elevation are not used"):
        read_plan(tmp_path / "legs.csv", options=options)


def test_a_log_with_places_alone_gets_heights(tmp_path, tiles):
    rows = [f"{i},10,1000,{48.2 + 1e-4 * i:.6f},11.5" for i in range(60)]
    assert not heights_of_a_log(tmp_path, rows, None)
    heights = heights_of_a_log(tmp_path, rows, Terrain(tiles))
    assert len(heights) == 60
    assert heights[-1] - heights[0] == pytest.approx(900.0 * 59e-4, abs=1.0)


def test_a_place_may_come_in_two_rows_as_apps_write_one_signal_a_row(tmp_path, tiles):
    rows = []
    for i in range(60):
        rows += [f"{i},10,1000,,", f"{i}.3,,,{48.2 + 1e-4 * i:.6f},", f"{i}.6,,,,11.5"]
    heights = heights_of_a_log(tmp_path, rows, Terrain(tiles))
    assert len(heights) > 100 and not any(map(math.isnan, heights))
    assert heights[-1] - heights[0] == pytest.approx(900.0 * 59e-4, abs=1.5)


def test_heights_of_a_log_stay_where_no_tile_has_one(tmp_path, tiles):
    rows = [f"{i},10,1000,{lat},11.5,123" for i, lat in enumerate([48.5] * 30 + [50.5] * 30)]
    header = "t_s,speed_mps,power_w,latitude,longitude,elevation_m"
    heights = heights_of_a_log(tmp_path, rows, Terrain(tiles), header)
    assert len(heights) == 60 and set(heights[31:]) == {123.0}
    assert heights[0] == pytest.approx(700.0, abs=1.0)


def test_recorded_altitudes_give_way_to_the_ground(tiles):
    reading = AltitudeReading(1, 5.0, 48.5, 11.5)
    beyond = AltitudeReading(2, 5.0, 50.5, 11.5)
    over = Terrain(tiles).over(Block.of([reading, beyond]))
    assert [r.altitude for r in over.readings()] == [pytest.approx(700.0, abs=1.0), 5.0]


def test_folders_without_tiles_and_broken_tiles_are_refused(tmp_path):
    with pytest.raises(InputError, match="no tile of elevation"):
        Terrain(tmp_path)
    with pytest.raises(InputError):
        Terrain(tmp_path / "nowhere")
    (tmp_path / "N48E011.hgt").write_bytes(b"\0" * 1000)
    with pytest.raises(InputError, match="no tile of 1201"):
        Terrain(tmp_path).heights(np.array([48.5]), np.array([11.5]))


def write_geotiff(path, crs, west, north, step, heights):
    from affine import Affine
    import rasterio

    size = {"height": heights.shape[0], "width": heights.shape[1], "count": 1}
    transform = Affine(step, 0.0, west, 0.0, -step, north)
    kind = {"driver": "GTiff", "dtype": "float32", "nodata": -9999.0, "compress": "deflate"}
    with rasterio.open(path, "w", crs=crs, transform=transform, **size, **kind) as file:
        file.write(heights.astype("float32"), 1)


def test_a_geotiff_has_heights_in_its_middle_of_cells_and_none_where_it_has_no_data(
    tmp_path, monkeypatch
):
    pytest.importorskip("rasterio")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    north, east = 48.6 - 0.001 * np.arange(600)[:, None], 11.2 + 0.001 * np.arange(400)
    heights = plane(north, east)
    heights[:10] = -9999.0
    write_geotiff(tmp_path / "a.tif", "EPSG:4326", 11.1995, 48.6005, 0.001, heights)
    terrain = Terrain(tmp_path)
    assert not [*(tmp_path / "temporary").iterdir()]  # that an interrupted end would leave
    latitude, longitude = np.array([48.0103, 48.5]), np.array([11.2107, 11.5])
    assert terrain.heights(latitude, longitude) == pytest.approx(
        plane(latitude, longitude), abs=0.01
    )
    nowhere = np.array([48.5999, 47.5, np.nan]), np.array([11.3, 11.3, 11.3])
    assert np.isnan(terrain.heights(*nowhere)).all()


def test_a_geotiff_of_another_projection_is_projected(tmp_path):
    pytest.importorskip("rasterio")
    from rasterio.warp import transform

    x, y = 680_000.0 + 30.0 * np.arange(500), 5_330_000.0 - 30.0 * np.arange(500)
    longitude, latitude = transform("EPSG:32632", "EPSG:4326", *map(np.ravel, np.meshgrid(x, y)))
    heights = plane(np.array(latitude), np.array(longitude)).reshape(500, 500)
    write_geotiff(tmp_path / "utm.tiff", "EPSG:32632", 679_985.0, 5_330_015.0, 30.0, heights)
    middle = np.array([latitude[125_250]]), np.array([longitude[125_250]])
    assert Terrain(tmp_path).heights(*middle) == pytest.approx(plane(*middle), abs=0.05)
