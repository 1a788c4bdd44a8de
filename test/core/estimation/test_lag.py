"""Speed and battery stamped at different moments: the lag is learned and taken out."""

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import islice, pairwise
from operator import attrgetter

import pytest

from evpinn_ros.common.saved_fields import plain
from evpinn_ros.core.estimation.estimate import Trust
from evpinn_ros.core.estimation.estimator import OnlineEstimator
from evpinn_ros.core.estimation.lag import SLEW, Aligned, Alignment, Lag, LagLearner
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
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


def parts(alignment: Alignment, readings) -> Iterator[Aligned]:
    """The aligned parts of readings."""
    block, first = Block.of(readings), 0
    while first < block.length:
        part = alignment.add_part(block.part(first, block.length))
        first += part.block.length
        yield part


def learned(readings) -> LagLearner:
    alignment = Alignment()
    deque(parts(alignment, readings), maxlen=0)
    return alignment._learner


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
    """An estimator that has learned the drive, its speed late by some seconds."""

    @cache
    def learn(lag) -> OnlineEstimator:
        estimator = new_estimator()
        outputs = estimator.add_block(Block.of(later(drive(1, 600.0).readings, lag)))
        assert set(outputs.measured.stamp_ns.tolist()) <= stamps
        estimator.finish()
        return estimator

    stamps = {r.stamp_ns for r in drive(1, 600.0).readings if isinstance(r, BatteryReading)}
    return learn


@pytest.mark.parametrize("lag", [-2.0, 1.0])
def test_parameters_are_those_without_a_lag(drives_of, lag):
    aligned, late = (drives_of(seconds).parameters() for seconds in (0.0, lag))
    for name, share in (("mu", 0.02), ("c_rr", 0.05), ("mass", 0.02)):
        value, expected = (those.parameters[name] for those in (late, aligned))
        assert value.value == pytest.approx(expected.value, rel=share)
        assert value.trust is expected.trust
    status = drives_of(lag).status()
    assert late.lag == status.lag and late.lag.seconds == pytest.approx(lag + OWN, abs=0.05)
    assert status.shift == pytest.approx(late.lag.seconds)
    assert drives_of(0.0).status().shift == 0.0


def test_the_lag_is_kept_with_the_car(drives_of, new_estimator):
    estimator, saved = new_estimator(), drives_of(1.0).export()
    estimator.restore(saved)
    assert estimator.status().lag == drives_of(1.0).status().lag
    assert estimator.status().shift == pytest.approx(estimator.status().lag.seconds)
    saved["lag"] = plain(Lag(-4.0, 0.1))  # more than can be taken out
    estimator.restore(saved)
    valid = {p.trust for p in drives_of(1.0).parameters().parameters.values()}
    doubted = {p.trust for p in estimator.parameters().parameters.values()}
    assert Trust.VALID in valid - doubted


def test_another_logger_has_another_lag(drive):
    """What is saved is left at once, for the drive so far is learned anew."""
    alignment = Alignment(Lag(1.0, 0.01))
    assert alignment.shift_ns == NANOSECONDS
    jumps = [part.jumps for part in parts(alignment, drive(1, SECONDS).readings)]
    assert sum(jumps) == 1 and alignment.shift_ns == 0 and alignment.settled


def test_the_shift_moves_slowly_and_never_in_a_dropout(drive):
    """From what was saved to what this drive shows, where these are near."""
    readings = later(drive(1, SECONDS).readings, 0.25)
    alignment = Alignment(Lag(0.42, 0.01))
    shifts = [(readings[0].stamp_ns, alignment.shift_ns)]
    begin_ns = readings[0].stamp_ns
    told = [
        reading
        for reading in readings
        if isinstance(reading, SpeedReading)
        or not 300 <= (reading.stamp_ns - begin_ns) // NANOSECONDS < 400
    ]
    for part in parts(alignment, told):
        stamps = part.block.of_kind(BatteryReading).stamps - part.shifts
        shifts += zip(stamps.tolist(), part.shifts.tolist(), strict=True)
        assert not part.jumps
    for (begin_ns, before), (end_ns, after) in pairwise(shifts):
        dropout = end_ns - begin_ns > 3 * NANOSECONDS
        assert abs(after - before) <= (0.0 if dropout else SLEW * (end_ns - begin_ns) + 1)
    assert alignment.shift_ns == pytest.approx((0.25 + OWN) * NANOSECONDS, abs=0.02 * NANOSECONDS)
