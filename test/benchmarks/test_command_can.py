"""`evpinn bench can` as a person meets it: real processes, a real bus, three seconds."""

import can
import pytest

from benchmarks.can_traffic import open_bus, own_port
from evpinn_ros.common.errors import InputError

pytestmark = pytest.mark.nightly


def test_a_short_run_measures_everything(bench):
    try:
        with open_bus(own_port()):
            pass
    except (InputError, can.CanError) as error:
        pytest.skip(str(error))
    printed, found = bench("can", "--minutes", "0.05")
    for line in ("frames lost", "share of one core", "p99", "candump file to readings"):
        assert line in printed
    live = found["live"]
    assert live["frames_sent"] == 12_000 and live["readings_sent"] == 300
    assert 0 < live["frames_received"] <= 12_000 and 0 < live["readings_heard"] <= 300
    assert 0 < live["core_share"] < 2 and 0 < live["idle"]["core_share"] < 2
    p50, p99, largest = live["latency_ms"]
    assert 0 < p50 <= p99 <= largest
    assert found["offline"]["frames"] == 200_000
