"""Hours through one chain: what is watched of them."""

import os
import time

import pytest

from benchmarks.cli.soak import Hour, drive_hours, memory_growth, time_drift
from benchmarks.processes import processor_seconds, resident_mb
from evpinn_ros.common.errors import InputError

pytestmark = pytest.mark.slow


def hours(*rows):
    return [Hour(1000, memory, took, 0.0) for memory, took in rows]


def test_memory_is_held_against_that_of_the_first_hour():
    assert memory_growth(hours((100, 1), (130, 1), (110, 1))) == pytest.approx(0.3)
    assert memory_growth(hours((100, 1), (90, 1))) == 0.0


def test_time_is_that_of_the_last_quarter_to_the_first():
    rows = [(1, 10.0), (1, 12.0), *[(1, 50.0)] * 4, (1, 11.0), (1, 22.0)]
    assert time_drift(hours(*rows)) == pytest.approx(16.5 / 11 - 1)


@pytest.mark.nightly
def test_one_chain_goes_through_every_hour():
    done = []
    found = list(drive_hours(2, time.process_time, done.append, 60.0))
    assert [hour.readings > 1000 for hour in found] == [True, True]
    assert found[1].energy > found[0].energy > 0
    assert max(done) > 60 and all(hour.us_per_reading > 0 for hour in found)


def test_memory_and_time_of_a_process_are_read():
    assert 10 < resident_mb(os.getpid()) < 10_000
    assert 0 < processor_seconds(os.getpid()) < 3600
    for read in (resident_mb, processor_seconds):
        with pytest.raises(InputError, match="the process ended"):
            read(2**22 + 1)
