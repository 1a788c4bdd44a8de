"""What was learned, saved and read again: in the estimator and on disk."""

from functools import cache
import json
import math
import tracemalloc

import pytest

from evpinn_ros.core.estimation.estimator import Mode, OnlineEstimator
from evpinn_ros.core.estimation.state_file import (
    MAX_FILE_BYTES,
    Half,
    read_state,
    refused_names,
    set_aside,
    write_halves,
    write_state,
)
from evpinn_ros.core.signals.readings import NANOSECONDS

MODES = [Mode.HYBRID, pytest.param(Mode.PAPER, marks=pytest.mark.torch)]
LEARNED_FOR = 15  # s


@pytest.fixture(scope="module")
def learned(drive, taught, new_estimator):
    """An estimator of a mode after LEARNED_FOR seconds."""
    readings = drive(1, 240.0).readings
    cut = readings[0].stamp_ns + LEARNED_FOR * NANOSECONDS

    @cache
    def of(mode: Mode) -> OnlineEstimator:
        if mode is Mode.HYBRID:
            return taught(LEARNED_FOR)
        estimator = new_estimator(mode=mode)
        estimator.add_readings(r for r in readings if r.stamp_ns < cut)
        return estimator

    return of


@pytest.mark.parametrize("mode", MODES)
def test_a_round_trip_through_a_file_is_exact(learned, new_estimator, tmp_path, mode):
    """What is saved is all that was learned, bit for bit."""
    estimator, other = learned(mode), new_estimator(mode=mode)
    write_state(tmp_path / "state.json", estimator.export())
    other.restore(read_state(tmp_path / "state.json"))
    assert other.export() == estimator.export()
    before, after = (owner.parameters().identifiable for owner in (estimator, other))
    assert before == pytest.approx(after, rel=1e-12)  # the order in memory shows in the last bit


def text_of(estimator) -> str:
    return repr(estimator.export())


@pytest.mark.parametrize("mode", MODES)
def test_a_refused_state_changes_nothing(learned, new_estimator, mode):
    good, estimator = learned(mode).export(), new_estimator(mode=mode)
    before = text_of(estimator)
    numbers = json.loads(json.dumps(good))
    first = "car" if mode is Mode.HYBRID else "network"
    last = "car" if mode is Mode.HYBRID else "variance"
    wrongs = [
        {},
        {**good, "version": 999},
        {**good, "vehicle": "tesla_model_s"},
        {**good, "mode": "paper" if mode is Mode.HYBRID else "hybrid"},
        {key: value for key, value in good.items() if key != "learner"},
        {**good, "learner": None},
        {**good, "learner": {k: v for k, v in good["learner"].items() if k != last}},
        *(
            {**good, "learner": {**numbers["learner"], first: wrong}}
            for wrong in ("text", [[1.0], [2.0, 3.0]], {"a": 1}, [10**400])
        ),
        {**good, "bands": None},
        {**good, "bands": {"predicted": [1.0], "smoothed": [1.0]}},
        {**good, "bands": {"predicted": [math.nan, 1.0], "smoothed": [1.0, 1.0]}},
    ]
    for wrong in wrongs:
        with pytest.raises(ValueError, match=r"."):
            estimator.restore(wrong)
        assert text_of(estimator) == before


def test_a_new_state_is_for_its_owner_alone(tmp_path):
    path = tmp_path / "car.json"
    for mode in (0o600, 0o640):
        write_halves(path, {Half.LEARNED: {}})
        assert path.stat().st_mode & 0o777 == mode
        path.chmod(0o640)
    set_aside(path, copied=True)
    assert refused_names(path)[0].stat().st_mode & 0o777 == 0o600


@pytest.mark.slow
def test_the_largest_state_takes_no_200_mb(tmp_path):
    """JSON of empty lists becomes thirty times as large: 20 MB took 594 MB. Here a quarter."""
    path = tmp_path / "state.json"
    path.write_text('{"a":[' + "[]," * ((MAX_FILE_BYTES // 4 - 10) // 3) + "[]]}")
    tracemalloc.start()
    read_state(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 200e6 / 4
