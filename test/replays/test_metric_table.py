"""Every key of a real replay's metrics has a meaning, and no meaning is without its key."""

from collections.abc import Iterator
import re
import time

import pytest

from docs.metric_table import METRICS
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.run import ReplayOptions, replay
from test.recorded import Recorded

pytestmark = pytest.mark.slow

ANY_NAME = {
    "parameters": "<name>",
    "breakdown": "<part>",
    "input.dropped": "<reason>",
    "updates.rejected": "<reason>",
    "by_battery_age": "<seconds>",
}


def keys(value, path: str = "") -> Iterator[str]:
    """Paths with dots; what stands below `ANY_NAME` under its placeholder."""
    if not isinstance(value, dict):
        yield path
        return
    for name, below in value.items():
        if path != "breakdown" or "kwh" in (below if isinstance(below, dict) else ()):
            name = ANY_NAME.get(path, name)
        yield from keys(below, f"{path}.{name}" if path else name)


def test_the_table_is_what_a_replay_writes(readings, vehicle):
    chain = Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter))
    options = ReplayOptions(withhold_battery_after=60.0, warm_up=10.0)
    source = Recorded(readings, short_frame=2)
    metrics = replay(source, chain, options, vehicle=vehicle.key, mode="hybrid").metrics
    metrics["updates"]["rejected"]["overrun"] = 1  # a computer that keeps up rejects nothing
    assert set(keys(metrics)) == {metric.key for metric in METRICS}


def test_every_key_is_told_once_and_has_a_meaning():
    assert len({metric.key for metric in METRICS}) == len(METRICS)
    assert all(metric.meaning for metric in METRICS)


def test_units_are_those_that_the_keys_end_with():
    ends = {"w": "W", "j": "J", "s": "s", "ms": "ms", "mb": "MB", "percent": "%"}
    ends |= {"kwh": "kWh", "100km": "kWh/100 km", "m": "m"}
    for metric in METRICS:
        end = re.split("[._]", metric.key)[-1]
        assert metric.unit == ends.get(end, ""), metric.key
