"""Speed and battery stamped at different moments: the lag is learned and taken out."""

from collections import deque
from dataclasses import replace
from functools import cache
from itertools import islice
from operator import attrgetter

import numpy as np
import pytest

from evpinn_ros.common.saved_fields import plain
from evpinn_ros.core.estimation.estimate import Trust
from evpinn_ros.core.estimation.estimator import OnlineEstimator
from evpinn_ros.core.estimation.lag import Aligner, Lag, LagLearner
from evpinn_ros.core.signals.block import Block, Rows
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.core.signals.reorder import in_order
from evpinn_ros.replays.simulation.sensors import BATTERY_LAG, SPEED_LAG

LAGS = [-2.0, 0.6, 1.0, 3.0]
SECONDS = 900.0
OWN = SPEED_LAG - BATTERY_LAG  # s, of the filters in the sensors of a simulated car


def later(readings, lag) -> list:
    """Readings of which the speeds are stamped `lag` seconds later, in order of stamps."""
    lag_ns = round(lag * NANOSECONDS)
    moved = (
        replace(reading, stamp_ns=reading.stamp_ns + lag_ns)
        if isinstance(reading, SpeedReading)
        else reading
        for reading in readings
    )
    return sorted(moved, key=attrgetter("stamp_ns"))


def polled(readings, every) -> list:
    """Of each signal every n-th reading, as a poller that asks one after the other."""
    speeds, batteries = (
        [reading for reading in readings if isinstance(reading, kind)]
        for kind in (SpeedReading, BatteryReading)
    )
    return [*islice(speeds, 0, None, every), *islice(batteries, every // 2, None, every)]


def learned(readings) -> LagLearner:
    aligner = Aligner()
    deque(aligner.learn(in_order(Block.of(readings))), maxlen=0)
    return aligner._learner


def test_how_a_drive_is_cut_changes_no_lag(drive):
    block = in_order(Block.of(later(drive(1, SECONDS).readings, 1.0)))
    whole, cut = Aligner(), Aligner()
    known = [*whole.learn(block)]
    assert len(known) > 5
    assert [row for part in block.parts(777) for row in cut.learn(part)] == known


@pytest.mark.parametrize("lag", [0.0, *LAGS])
@pytest.mark.parametrize(("every", "error"), [(1, 0.05), (10, 0.1), (20, 0.2), (50, 0.5)])
def test_a_lag_is_learned(drive, lag, every, error):
    """Within 0.05 s at 10 Hz and a tenth of the period when polled."""
    learner = learned(later(polled(drive(1, SECONDS).readings, every), lag))
    assert learner.lag.seconds == pytest.approx(lag + OWN, abs=error)
    assert learner.known


def test_a_car_that_keeps_its_speed_shows_no_lag(cruise):
    assert learned(cruise(0, SECONDS)).lag is None


@pytest.fixture(scope="module")
def drives_of(new_estimator, drive):
    """An estimator that has learned two drives, their speed late by some seconds."""

    @cache
    def learn(lag) -> OnlineEstimator:
        estimator = new_estimator()
        for _ in range(2):
            outputs = estimator.add_block(Block.of(later(drive(1, 600.0).readings, lag)))
            assert set(outputs.measured.stamp_ns.tolist()) <= stamps
            estimator.begin_next_drive()
        return estimator

    stamps = {r.stamp_ns for r in drive(1, 600.0).readings if isinstance(r, BatteryReading)}
    return learn


def test_a_drive_has_one_clock_and_the_next_one_that_of_its_lag(drives_of, new_estimator, drive):
    estimator = new_estimator()
    estimator.add_block(Block.of(later(drive(1, 600.0).readings, 1.0)))
    assert estimator.status().lag.seconds == pytest.approx(1.0 + OWN, abs=0.05)
    assert estimator.status().shift == 0.0
    assert Trust.VALID not in {p.trust for p in estimator.parameters().parameters.values()}
    estimator.begin_next_drive()
    assert estimator.status().shift == pytest.approx(estimator.status().lag.seconds)
    assert drives_of(0.0).status().shift == 0.0


@pytest.mark.parametrize("lag", [-2.0, 3.0])
def test_a_battery_whose_stamps_are_moved_back_is_not_late(drives_of, lag):
    status = drives_of(lag).status()
    assert abs(status.shift) > 0.4 and not status.dropped


def test_the_lag_is_kept_with_the_car(drives_of, new_estimator, drive):
    estimator, saved = new_estimator(), drives_of(1.0).export()
    estimator.restore(saved)
    assert estimator.status().lag == drives_of(1.0).status().lag
    assert estimator.status().shift == pytest.approx(estimator.status().lag.seconds)
    saved["lag"] = plain(Lag(-4.0, 0.1))  # more than can be taken out
    doubtful = new_estimator()
    doubtful.restore(saved)
    readings = Block.of(later(drive(1, 600.0).readings, 1.0))
    for taught, valid in ((estimator, True), (doubtful, False)):
        taught.add_block(readings)
        trusts = {p.trust for p in taught.parameters().parameters.values()}
        assert (Trust.VALID in trusts) == valid


def test_another_logger_has_another_lag(drive):
    """What is saved counts for the drive, and the lag that it shows for the next."""
    aligner = Aligner(Lag(1.0, 0.01))
    block = in_order(aligner.shifted(Block.of(drive(1, SECONDS).readings)))
    assert aligner.shift_ns == NANOSECONDS
    *_, (_, known) = aligner.learn(block)
    assert known.doubtful and known.lag.seconds == pytest.approx(OWN, abs=0.05)
    assert Aligner(aligner.saved).shift_ns == 0


def test_a_log_whose_rate_changes_back_and_forth_ends():
    """Once, each change of the step began the same block again, for ever."""
    learner = LagLearner()
    for begin in range(0, 20_000, 1000):
        step = 10 if begin % 2000 else 1
        seconds = np.arange(begin, begin + 1000, step)
        stamps = seconds * NANOSECONDS
        count = len(stamps)
        speeds, battery = (
            Rows(np.arange(count), stamps, np.full((fields, count), 10.0)) for fields in (2, 4)
        )
        list(learner.extend(speeds, battery))
    assert learner._start > 19_000
