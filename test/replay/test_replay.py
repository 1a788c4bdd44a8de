"""The chain over recorded drives: L0 of the replay tests."""

from collections import Counter
from dataclasses import replace
import hashlib
import json
import time

import numpy as np
import pytest

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.errors import InputError
from evpinn_ros.estimation.estimator import EstimatorSettings, Mode
from evpinn_ros.estimation.worker import InlineWorker
from evpinn_ros.nodes.topics import topic_of
from evpinn_ros.replay.chain import Chain
from evpinn_ros.replay.run import ReplayOptions, output_folders, replay
from evpinn_ros.signals.readings import BatteryReading, SpeedReading


class Recorded:
    """Readings in memory, as a source."""

    problem = None

    def __init__(self, readings, path) -> None:
        self.path, self._readings = path, readings
        self.dropped: Counter[str] = Counter()

    def readings(self):
        yield from self._readings


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
    found = json.loads(json.dumps(metrics, allow_nan=False))
    del found["replay"], found["updates"]["p50_ms"], found["updates"]["p99_ms"]
    return json.dumps(found)


def test_same_readings_give_the_same_bytes(readings, vehicle, tmp_path):
    digests, found = [], []
    for name in ("first", "second"):
        with BagWriter(tmp_path / name / "bag") as writer:
            result = run(readings[:1200], vehicle, tmp_path, writer=writer)
        found.append(without_timing(result.metrics))
        (bag,) = (tmp_path / name / "bag").glob("*.mcap")
        digests.append(hashlib.sha256(bag.read_bytes()).hexdigest())
    assert digests[0] == digests[1]
    assert found[0] == found[1]


def test_output_bag_holds_the_contract_topics(readings, vehicle, tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        run(readings[:600], vehicle, tmp_path, writer=writer)
    with BagReader(tmp_path / "bag") as bag:
        names = {topic_of(name).name for name in bag.topics}
    assert {
        "vehicle/speed",
        "battery/state",
        "estimate/parameters",
        "estimate/identifiable",
        "estimate/bounds",
        "estimate/eta",
        "power/measured",
        "power/predicted",
        "power/smoothed",
        "energy/state",
        "energy/consumed",
    } <= names


def test_predictions_are_made_before_the_battery_is_heard(readings, vehicle, tmp_path):
    """Whatever the battery says from some moment on, nothing before that moment may change."""
    turn = readings[len(readings) // 2].stamp_ns
    liar = [
        replace(r, current=r.current + 80.0)
        if isinstance(r, BatteryReading) and r.stamp_ns >= turn
        else r
        for r in readings
    ]
    honest, lied = (run(each, vehicle, tmp_path).drive for each in (readings, liar))
    begin = (turn - readings[0].stamp_ns) / 1e9
    for series in ("smoothed", "newest"):
        a, b = getattr(honest, series), getattr(lied, series)
        before = a.time <= begin
        assert before.sum() > 300
        assert np.array_equal(a.power[before], b.power[before])
        assert not np.array_equal(a.power[~before], b.power[~before])


def test_withheld_battery_gives_finite_predictions_to_the_end(readings, vehicle, tmp_path):
    result = run(readings, vehicle, tmp_path, withhold_battery_after=60.0)
    drive = result.drive
    assert drive.smoothed.time[-1] > drive.duration - 1.0
    assert np.isfinite(drive.smoothed.power).all() and np.isfinite(drive.newest.power).all()
    withheld = result.metrics["withheld"]
    assert withheld["from_s"] == 60.0
    assert withheld["power"]["rmse_w"] > 0
    assert withheld["energy"]["measured_j"] is not None
    # What was withheld was not learned: what the data determine stays as it was.
    rows = drive.combinations["mass_over_eta"]
    silent = rows[rows[:, 0] > 66.0]
    assert len(silent) > 10 and (silent[:, 1:] == silent[0, 1:]).all()


def test_no_battery_predicts_from_the_priors(readings, vehicle, tmp_path):
    speed = [r for r in readings if isinstance(r, SpeedReading)]
    result = run(speed, vehicle, tmp_path)
    assert len(result.drive.smoothed.power) > 500
    assert result.metrics["power"]["rmse_w"] is None
    assert result.metrics["energy"]["error_percent"] is None
    mass = result.metrics["parameters"]["mass"]
    assert mass["value"] == pytest.approx(vehicle.initial.mass, rel=1e-6)
    assert (mass["prior_share"], mass["state"]) == (pytest.approx(1.0), "unestimated")


def test_no_speed_is_an_error(readings, vehicle, tmp_path):
    battery = [r for r in readings if isinstance(r, BatteryReading)]
    with pytest.raises(InputError, match="no speed"):
        run(battery, vehicle, tmp_path)


def test_what_was_learned_is_carried_to_the_next_drive(readings, vehicle, tmp_path):
    used = chain(vehicle)
    first = run(readings, vehicle, tmp_path, used=used)
    used.begin_next_drive()
    later = [replace(r, stamp_ns=r.stamp_ns + 10**13) for r in readings[:100]]
    second = run(later, vehicle, tmp_path, used=used)
    mass = [result.metrics["parameters"]["mass"]["value"] for result in (first, second)]
    assert mass[1] == pytest.approx(mass[0], rel=0.01)
    assert mass[1] != vehicle.initial.mass
    assert second.metrics["updates"]["count"] < first.metrics["updates"]["count"]


def test_paper_mode_runs_and_learns(readings, vehicle, tmp_path):
    result = run(readings[:900], vehicle, tmp_path, mode=Mode.PAPER)
    assert np.isfinite(result.drive.smoothed.power).all()
    assert result.metrics["updates"]["accepted"] > 10
    assert result.metrics["parameters"]["mass"]["value"] != vehicle.initial.mass


def test_each_of_several_drives_has_a_folder(tmp_path):
    paths = [tmp_path / "a.csv.gz", tmp_path / "b"]
    assert output_folders(tmp_path / "out", paths) == [
        tmp_path / "out" / "001_a",
        tmp_path / "out" / "002_b",
    ]
    assert output_folders(tmp_path / "out", paths[:1]) == [tmp_path / "out"]
    assert output_folders(None, paths) == [None, None]


def test_energy_state_carries_sigma_that_grows_while_withheld(readings, vehicle, tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        run(readings, vehicle, tmp_path, writer=writer, withhold_battery_after=60.0)
    with BagReader(tmp_path / "bag") as bag:
        states = [r.message for r in bag.records(["/ev/energy/state"])]
    assert all(len(state.effort) == len(state.name) for state in states[1:])
    index = list(states[-1].name).index("predicted")
    assert 0 < states[len(states) // 2].effort[index] < states[-1].effort[index]


def test_a_recording_that_starts_over_counts_on(readings, vehicle, tmp_path):
    used = chain(vehicle)
    seen = []
    for reading in [*readings[:900], *readings[:900]]:
        list(used.push(reading))
        seen.append(used.meter.state.predicted.energy)
    once, twice = seen[len(seen) // 2 - 1], seen[-1]
    assert once > 0
    # The first seconds after the jump are needed to notice it, so less than twice.
    assert 1.5 * once < twice < 2.5 * once
