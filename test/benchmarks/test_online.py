"""The same samples for all, predicted before they are learned from."""

from collections.abc import Iterable
from dataclasses import replace
import math
import time

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from benchmarks.online import METHODS, OnlineBenchmark, Run
from benchmarks.scores import log_scores
from evpinn_ros.estimation.estimator import EstimatorSettings
from evpinn_ros.estimation.worker import InlineWorker
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.history import History
from evpinn_ros.replays.scoring import drive_scores
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.vehicle.files import load_vehicle

pytestmark = pytest.mark.torch

CAUSAL = [name for name in METHODS if name != "split"]  # which interpolates, and says so
SERIES = ("smoothed", "newest")


def run(vehicle, names: Iterable[str], readings: Iterable[Reading]) -> Run:
    benchmark = OnlineBenchmark(vehicle, names, time.thread_time)
    for reading in readings:
        benchmark.add_reading(reading)
    return benchmark.finish()


@pytest.fixture(scope="module")
def whole(vehicle, readings) -> Run:
    return run(vehicle, METHODS, readings)


@pytest.mark.nightly
def test_all_methods_predict_the_same_moments(whole):
    assert set(whole.predicted) == set(CAUSAL)
    for series in SERIES:
        times = [getattr(whole.predicted[name], series).time for name in CAUSAL]
        # At the first moment no battery has spoken: there is no value to hold.
        assert {len(time) for time in times[1:]} == {len(times[1])}
        assert len(times[1]) - len(times[0]) <= 1
        for time_ in times:
            assert np.array_equal(time_, times[1][-len(time_) :])
    assert whole.moments == len(whole.predicted["hybrid"].smoothed.time) > 150


def test_hybrid_scores_as_in_replay(vehicle, readings, whole):
    chain = Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter))
    history = History()
    for reading in readings:
        history.add_reading(reading)
        for output in chain.add_reading(reading):
            history.add_output(output)
    replayed = drive_scores(history.drive(), 5.0)
    benched = drive_scores(whole.predicted["hybrid"], 5.0)
    for key in ("power", "power_now"):
        assert benched[key] == replayed[key]
    predicted = chain.meter.state.predicted.energy
    assert whole.predicted["hybrid"].energy[-1, 1] == pytest.approx(predicted, rel=1e-12)


def test_baseline_holds_the_battery_reading_before(whole, readings):
    powers = [r.power for r in readings if isinstance(r, BatteryReading)]
    for series in SERIES:
        held = getattr(whole.predicted["null"], series)
        # The battery speaks 30 ms after each speed: the newest before a moment is 70 ms old.
        for moment, power in zip(held.time, held.power, strict=True):
            assert power == powers[round(10 * moment) - 1]


def test_a_reading_of_the_moment_itself_is_not_before_it(vehicle):
    readings: list[Reading] = []
    for i in range(40):
        stamp = 1_700_000_000 * NANOSECONDS + i * NANOSECONDS // 10
        readings += [BatteryReading(stamp, 400.0, -float(i)), SpeedReading(stamp, 5.0)]
    held = run(vehicle, ["null"], readings).predicted["null"].newest
    assert held.power == pytest.approx(400.0 * (np.round(10 * held.time) - 1))


# The networks' updates make a run long; one test of all methods, many of the quick ones.
def test_no_method_sees_the_power_of_its_own_sample(vehicle, readings, whole):
    assert_causal(vehicle, CAUSAL, readings, whole, 150, 60_000.0)


@settings(max_examples=10, deadline=None)
@given(k=st.integers(1, 118), power=st.floats(-1e5, 1e5))
def test_no_peer_sees_the_power_of_its_own_sample(k, power):
    vehicle = load_vehicle("tesla_model_3_lr")
    names = [name for name in CAUSAL if name not in ("paper", "hybrid")]
    readings = short_drive()
    assert_causal(vehicle, names, readings, run(vehicle, names, readings), k, power)


def short_drive() -> list[Reading]:
    """Twelve seconds, speed and battery of the same moments."""
    found: list[Reading] = []
    for i in range(120):
        stamp = 1_700_000_000 * NANOSECONDS + i * NANOSECONDS // 10
        found.append(SpeedReading(stamp, 10.0 + 5.0 * math.sin(i / 15.0)))
        found.append(BatteryReading(stamp, 350.0, -20.0 + 15.0 * math.cos(i / 9.0)))
    return found


def assert_causal(vehicle, names, readings, before: Run, k: int, power: float) -> None:
    """Changing the k-th battery reading changes no prediction up to its moment."""
    index = [i for i, r in enumerate(readings) if isinstance(r, BatteryReading)][k]
    changed = list(readings)
    changed[index] = replace(changed[index], current=-power / changed[index].voltage)
    after = run(vehicle, names, changed)
    moment = (changed[index].stamp_ns - changed[0].stamp_ns) / NANOSECONDS
    for name in names:
        for series in SERIES:
            was, now = (getattr(r.predicted[name], series) for r in (before, after))
            same = was.time <= moment
            assert np.array_equal(was.power[same], now.power[same]), (name, series)
            assert np.array_equal(was.sigma[same], now.sigma[same], equal_nan=True)


def test_a_changed_power_does_change_what_follows(vehicle):
    readings = short_drive()
    names = ["null", "ekf5"]
    before = run(vehicle, names, readings)
    index = [i for i, r in enumerate(readings) if isinstance(r, BatteryReading)][60]
    readings[index] = replace(readings[index], current=-100.0)
    after = run(vehicle, names, readings)
    for name in names:
        was, now = (r.predicted[name].smoothed.power for r in (before, after))
        assert not np.array_equal(was, now)


def test_time_is_counted_where_a_method_runs(vehicle, readings, whole):
    scores = log_scores(whole, METHODS, 5.0)
    assert scores["null"]["us_per_sample"] is scores["split"]["us_per_sample"] is None
    assert 0 < scores["prior"]["us_per_sample"] < scores["hybrid"]["us_per_sample"]
    assert whole.stream_s > 0
