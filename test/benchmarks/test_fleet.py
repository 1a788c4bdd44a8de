"""Fleets of simulated cars, small."""

import time

import pytest

from benchmarks.fleet import COMPARED, many_drives, recovered, scaling
from evpinn_ros.vehicle.files import load_vehicle

pytestmark = pytest.mark.nightly

LEAF = load_vehicle("nissan_leaf")


@pytest.fixture(autouse=True)
def _parquet():
    pytest.importorskip("pyarrow", reason="the extra fleet is not installed")


def test_every_drive_is_learned_and_counted(tmp_path):
    cars = many_drives(tmp_path / "many", LEAF, 22, 10.0)
    assert [len(car.drives) for car in cars] == [10, 10, 2]
    counts = []
    found = scaling(cars, tmp_path / "out", 1, time.perf_counter, counts.append, lambda: False)
    assert found.drives == 22 and found.drives_per_s > 0
    assert counts == [10, 20, 30], "by cars of ten"
    counts.clear()
    stopped = scaling(
        cars,
        tmp_path / "stopped",
        1,
        time.perf_counter,
        counts.append,
        lambda: len(counts) == 2,
    )
    assert stopped.drives == 20, "it tells how far it came"
    assert min(*found.quarters_s, *found.rss_mb, found.start_s, found.tables_s) > 0


def test_a_known_population_is_found(tmp_path):
    """Four cars: within three of the sigmas that are stated; a shift of half a sigma is seen."""
    counts = []
    found = recovered(tmp_path, LEAF, 4, 100.0, 1, 5, counts.append, lambda: False)
    assert [one.name for one in found] == list(COMPARED) and counts == list(range(1, 9))
    for one in found:
        assert abs(one.learned.mean - one.mean) < 3 * one.learned.mean_std, one
        assert abs(one.learned.spread - one.spread) < 3 * one.learned.spread_std, one
