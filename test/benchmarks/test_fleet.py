"""Fleets of simulated cars, small."""

import time

import pytest

from benchmarks.fleet import COMPARED, many_drives, recovered, scaling
from evpinn_ros.vehicle.files import load_vehicle

LEAF = load_vehicle("nissan_leaf")


@pytest.fixture(autouse=True)
def _parquet():
    pytest.importorskip("pyarrow", reason="the extra fleet is not installed")


def test_every_drive_is_learned_and_counted(tmp_path):
    cars = many_drives(tmp_path / "many", LEAF, 22, 10.0)
    assert [len(car.drives) for car in cars] == [10, 10, 2]
    told = []
    found = scaling(cars, tmp_path / "out", 1, time.perf_counter, told.append, lambda: False)
    assert found.drives == 22 and found.drives_per_s > 0
    assert told == [10, 20, 30], "by cars of ten"
    told.clear()
    stopped = scaling(
        cars, tmp_path / "stopped", 1, time.perf_counter, told.append, lambda: len(told) == 2
    )
    assert stopped.drives == 20, "it tells how far it came"
    assert min(*found.quarters_s, *found.rss_mb, found.start_s, found.tables_s) > 0


def test_a_known_population_is_found(tmp_path):
    """Four cars: within three of the sigmas that are stated; a shift of half a sigma is seen."""
    told = []
    found = recovered(tmp_path, LEAF, 4, 100.0, 1, 5, told.append, lambda: False)
    assert [one.name for one in found] == list(COMPARED) and told == list(range(1, 9))
    for one in found:
        assert abs(one.told.mean - one.mean) < 3 * one.told.mean_std, one
        assert abs(one.told.spread - one.spread) < 3 * one.told.spread_std, one
