"""The chain over recorded drives: L0 of the replay tests."""

import hashlib
import json
import math
import time

import numpy as np
import pytest

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.core.estimation.estimator import EstimatorSettings, Mode
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.core.signals.time_jump import JumpPolicy, JumpRule
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.events import EventKind, drive_events
from evpinn_ros.replays.run import ReplayOptions, replay
from evpinn_ros.topics.readings import to_reading
from test.recorded import Recorded

pytestmark = pytest.mark.slow


def chain(vehicle, mode=Mode.HYBRID) -> Chain:
    return Chain(vehicle, EstimatorSettings(mode=mode), InlineWorker(time.perf_counter))


def run(readings, vehicle, tmp_path, *, writer=None, mode=Mode.HYBRID, used=None, **options):
    return replay(
        Recorded(readings, tmp_path / "drive"),
        used or chain(vehicle, mode),
        ReplayOptions(warm_up=30.0, **options),
        vehicle=vehicle.key,
        mode=mode.value,
        writer=writer,
    )


def without_timing(metrics) -> str:
    document = json.loads(json.dumps(metrics, allow_nan=False))
    del document["replay"], document["updates"]["p50_ms"], document["updates"]["p99_ms"]
    return json.dumps(document)


@pytest.fixture(scope="module")
def once(readings, vehicle, tmp_path_factory):
    """The first 45 s of it: the readings, what replay gives, and the chain at their end."""
    first, used = readings[:900], chain(vehicle)
    return first, run(first, vehicle, tmp_path_factory.mktemp("once"), used=used), used


def test_same_readings_give_the_same_bytes(readings, vehicle, tmp_path):
    digests, metrics = [], []
    for name in ("first", "second"):
        with BagWriter(tmp_path / name / "bag") as writer:
            result = run(readings[:1200], vehicle, tmp_path, writer=writer)
        metrics.append(without_timing(result.metrics))
        (bag,) = (tmp_path / name / "bag").glob("*.mcap")
        digests.append(hashlib.sha256(bag.read_bytes()).hexdigest())
    assert digests[0] == digests[1]
    assert metrics[0] == metrics[1]


def test_mode_paper_which_is_slow_reports_its_progress_all_along(once, vehicle, tmp_path):
    source, options, moments = Recorded(once[0], tmp_path), ReplayOptions(), [0.0]
    named = {"vehicle": vehicle.key, "mode": Mode.PAPER.value}  # the chain is a quick one
    replay(source, chain(vehicle), options, **named, progress=moments.append)
    assert max(np.diff([*moments, 45.0])) < 15.0


def test_a_drive_that_starts_over_is_reset_where_the_policy_says_so(once, vehicle, tmp_path):
    """Its second turn gives the numbers of the first; its bag is read in the order it had."""
    (once, single, _), folder, rule = once, tmp_path / "bag", JumpRule(JumpPolicy.RESET)
    used = Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter), rule)
    with BagWriter(folder) as writer:
        looped = run([*once, *once], vehicle, tmp_path, writer=writer, used=used)
    both, turn = looped.drive, single.drive
    half = len(both.smoothed.time) // 2
    for column, alone in zip(both.smoothed[1:3], turn.smoothed[1:3], strict=True):
        assert np.array_equal(column[:half], alone) and np.array_equal(column[half:], alone)
    np.testing.assert_allclose(both.energy[len(turn.energy) :, 1:], turn.energy[:, 1:], rtol=1e-9)
    for name in turn.parameters:
        assert looped.metrics["parameters"][name] == single.metrics["parameters"][name]
    assert (np.diff(both.speed[:, 0]) > 0).all() and (np.diff(both.energy[:, 0]) >= 0).all()
    assert looped.metrics["energy"]["measured_j"] == pytest.approx(
        2 * single.metrics["energy"]["measured_j"], rel=1e-6
    )
    back = (once[-1].stamp_ns - once[0].stamp_ns) / NANOSECONDS
    (event,) = [e for e in drive_events(both) if e.kind is EventKind.RESET]
    assert f"{back:.0f} s" in event.text
    with BagReader(folder) as bag:
        stamps = [
            to_reading(record.type_name, record.message).stamp_ns
            for record in bag.records()
            if record.topic.endswith("vehicle/speed")
        ]
    speeds = [reading.stamp_ns for reading in once if isinstance(reading, SpeedReading)]
    assert stamps == [*speeds, *speeds]


def test_to_hold_keeps_what_was_learned_and_counted(once, vehicle, tmp_path):
    (once, _, single), rule = once, JumpRule(JumpPolicy.HOLD)
    used = Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter), rule)
    run([*once, *once], vehicle, tmp_path, used=used)
    counted, alone = (driven.account.since_reset().distance for driven in (used, single))
    assert counted == pytest.approx(2 * alone, rel=0.01)
    stds = [e.estimator.parameters().parameters["eta"].std for e in (used, single)]
    assert stds[0] != stds[1]


@pytest.mark.parametrize("seed", range(3))
def test_a_speed_that_is_late_at_random_changes_no_measured_energy(once, vehicle, seed):
    """By up to 3 s; what comes behind the battery's newest reading used to begin time anew."""
    drive, _, alone = once
    rng = np.random.default_rng(seed)
    late_ns = [rng.uniform(0, 3) * NANOSECONDS * isinstance(r, SpeedReading) for r in drive]
    used = chain(vehicle)
    order = np.argsort([r.stamp_ns + late for r, late in zip(drive, late_ns, strict=True)])
    assert [*used.add_readings([drive[i] for i in order])]
    used.account.flush()
    states = used.account.state, alone.account.state
    assert states[0].measured.energy == pytest.approx(states[1].measured.energy, rel=1e-3)
    assert states[0].unknown_s == 0.0
    error = states[0].consumed - states[1].consumed
    assert abs(error) < 2.0 * states[0].consumed_sigma


@pytest.mark.parametrize("seconds", [5.0, 10.0, 25.0, 60.0, 120.0])
def test_what_is_taken_while_speed_and_battery_are_silent_is_in_sigma(vehicle, seconds):
    """Where they are NaN too, which changes nothing."""
    at = np.arange(0.0, 130.0 + seconds, 0.1)
    speed = np.maximum(0.0, 12.0 + 8.0 * np.sin(at / 7.0) + 5.0 * np.sin(at / 3.1))
    wheels = (1900.0 * np.gradient(speed, at) + 186.0 + 0.4 * speed**2) * speed
    power = 800.0 + np.where(wheels > 0.0, wheels / 0.9, 0.7 * wheels)
    told = np.where((at >= 100.0) & (at < 100.0 + seconds), math.nan, 1.0)
    stamps = 1_700_000_000 * NANOSECONDS + np.rint(at * NANOSECONDS).astype(np.int64)
    rows = zip(
        stamps.tolist(), (told * speed).tolist(), (told * power / -350).tolist(), strict=True
    )
    pairs = [(SpeedReading(ns, v), BatteryReading(ns, 350.0, i)) for ns, v, i in rows]
    states = []
    for given in (pairs, [pair for pair in pairs if not math.isnan(pair[0].speed)]):
        used = chain(vehicle)
        assert [*used.add_readings(reading for pair in given for reading in pair)]
        used.account.flush()
        states.append(used.account.state)
    state, of_silence = states
    assert state == of_silence and state.unknown_s == pytest.approx(seconds, abs=0.2)
    taken = ((power[1:] + power[:-1]) / 2).sum() / 10
    assert abs(state.consumed - taken) < 2.0 * state.consumed_sigma


def test_a_stray_stamp_stops_nothing(readings, vehicle):
    """One speed and one battery from the far future, and one impossible speed from there too."""
    future, used = 2**62, chain(vehicle)
    strays = [
        SpeedReading(future, math.nan),
        BatteryReading(future, 350.0, -10.0),
        readings[0],
        SpeedReading(future, 5.0),
    ]
    outputs = []
    for index, reading in enumerate(readings[:400]):
        for taken in [*strays[index // 100 : index // 100 + 1][: index % 100 == 99], reading]:
            outputs += used.add_readings([taken])
    fresh = chain(vehicle)
    in_order = [output for reading in readings[:400] for output in fresh.add_readings([reading])]
    assert repr(outputs) == repr(in_order)
    assert used.dropped == {"stamp_leaps": 4}


def test_withheld_battery_gives_finite_predictions_to_the_end(readings, vehicle, tmp_path):
    result = run(readings, vehicle, tmp_path, withhold_battery_after=60.0)
    drive = result.drive
    assert drive.smoothed.time[-1] > drive.duration - 1.0
    assert np.isfinite(drive.smoothed.power).all() and np.isfinite(drive.newest.power).all()
    scores = result.metrics["withheld"]
    assert scores["from_s"] == 60.0
    assert scores["power"]["rmse_w"] > 0
    assert scores["energy"]["measured_j"] is not None
    # What was withheld was not learned: what the data determine stays as it was.
    rows = drive.combinations["mass_over_eta"]
    silent = rows[rows[:, 0] > 66.0]
    assert len(silent) > 10 and (silent[:, 1:] == silent[0, 1:]).all()
