"""Hours through one chain: what is watched of them."""

import time

import pytest

from benchmarks.cli.soak import drive_hours

pytestmark = pytest.mark.slow


@pytest.mark.nightly
def test_one_chain_goes_through_every_hour():
    done = []
    found = list(drive_hours(2, time.process_time, done.append, 60.0))
    assert [hour.readings > 1000 for hour in found] == [True, True]
    assert found[1].energy > found[0].energy > 0
    assert max(done) > 60 and all(hour.us_per_reading > 0 for hour in found)
