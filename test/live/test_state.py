import math

import pytest

from evpinn_ros import topics
from evpinn_ros.bags.types import new_message
from evpinn_ros.live.state import (
    MOST_ARRIVALS,
    MOST_PARTS,
    RATE_WINDOW,
    STALE_AFTER,
    LiveState,
)
from evpinn_ros.topics.messages import Level, diagnostics, named_vector


def said(name, level, text, **values):
    return diagnostics(new_message, 10**9, [(name, level, text, values)])


def test_before_anything_was_heard_it_says_so_and_knows_nothing():
    state = LiveState()
    ((level, text),) = state.problems(5.0)
    assert level is Level.WARN and "ROS_DOMAIN_ID" in text
    assert all(math.isnan(row.value) and row.state == "" for row in state.parameters())
    assert math.isnan(state.power(topics.POWER_MEASURED, 5.0).value)
    assert state.rate(topics.SPEED, 5.0) == 0.0


def test_what_is_heard_is_known(well):
    state = well(110.0)
    eta, mu = state.parameters()[:2]
    assert eta == ("eta", 0.912, pytest.approx(0.0456), 0.456, 1.824, 0.25, 87.0, "valid")
    assert math.isnan(mu.progress) and mu.state == ""
    assert state.power(topics.POWER_PREDICTED, 110.0) == (13900.0, 1200.0)
    assert math.isnan(state.power(topics.POWER_MEASURED, 110.0).sigma)
    assert state.fresh_battery(110.0).current == pytest.approx(-41.5)
    assert state.seen()[0][0] == 12 and state.seen()[1][4] == 3400
    assert math.isnan(state.seen()[2][0])
    assert state.band_coverage() == 0.893
    assert state.problems(110.0) == []


def test_rates_are_those_of_late(well):
    state = well(110.0)
    assert state.rate(topics.SPEED, 110.0) == pytest.approx(10.0, rel=0.03)
    assert state.rate(topics.SPEED, 110.0 + RATE_WINDOW / 2) == pytest.approx(5.0, rel=0.05)
    assert state.rate(topics.SPEED, 110.0 + RATE_WINDOW) == 0.0


def test_a_rate_is_right_from_the_beginning(well):
    assert well(102.0).rate(topics.SPEED, 102.0) == pytest.approx(10.0, rel=0.06)


def test_silence_is_shown_and_named(well):
    state, late = well(110.0), 110.0 + STALE_AFTER
    assert math.isnan(state.fresh_speed(late)) and state.fresh_battery(late) is None
    assert math.isnan(state.power(topics.POWER_MEASURED, late).value)
    assert state.activity(late) == ""
    ((level, text),) = state.problems(late)
    assert level is Level.ERROR and text.startswith("estimator: ") and "3 s" in text
    assert state.parameters()[0].value == 0.912  # what was learned holds


def test_reasons_come_from_diagnostics_the_worst_first(well):
    state = well(110.0)
    state.take(topics.DIAGNOSTICS, said("/ev/energy: meter", Level.WARN, "predicting"), 110.0)
    state.take(topics.DIAGNOSTICS, said("/ev/can_bridge: bus", Level.ERROR, "lost"), 110.0)
    assert state.problems(110.0) == [
        (Level.ERROR, "can_bridge: bus: lost"),
        (Level.WARN, "energy: meter: predicting"),
    ]
    state.take(topics.DIAGNOSTICS, said("/ev/can_bridge: bus", Level.OK, "receiving"), 110.5)
    assert state.problems(110.5) == [(Level.WARN, "energy: meter: predicting")]


def test_diagnostics_of_others_are_none_of_ours():
    state = LiveState()
    state.take(topics.DIAGNOSTICS, said("/ev/camera: driver", Level.ERROR, "hot"), 1.0)
    assert state.statuses == {}
    ((level, text),) = state.problems(1.0)
    assert level is Level.WARN and "/diagnostics" in text


def test_each_view_shows_the_diagnostics_of_its_own_car():
    near, far = LiveState("/robot1/ev"), LiveState("/robot2/ev")
    message = said("/robot1/ev/can_bridge: bus", Level.ERROR, "lost")
    for state in (near, far):
        state.take(topics.DIAGNOSTICS, message, 1.0)
    assert near.problems(1.0) == [(Level.ERROR, "can_bridge: bus: lost")]
    assert far.statuses == {}
    ((_, text),) = far.problems(1.0)
    assert text.endswith("nodes run under /robot1/ev (--namespace)")


def test_parts_without_end_fill_no_memory():
    state = LiveState()
    for number in range(10 * MOST_PARTS):
        message = said(f"/ev/estimator: part {number}", Level.OK, "")
        state.take(topics.DIAGNOSTICS, message, 1.0)
    assert len(state.statuses) == MOST_PARTS
    assert state.unusable[topics.DIAGNOSTICS.name] == 9 * MOST_PARTS
    state.take(topics.DIAGNOSTICS, said("/ev/estimator: part 0", Level.WARN, "well known"), 1.0)
    assert (Level.WARN, "estimator: part 0: well known") in state.problems(1.0)


def test_messages_that_nobody_counts_fill_no_memory():
    """No rate is shown of most topics, and of none where there is no terminal."""
    state, message = LiveState(), named_vector(new_message, 10**9, ["power"], [1.0])
    for number in range(3 * MOST_ARRIVALS):
        state.take(topics.POWER_MEASURED, message, 100.0 + 0.01 * number)
    assert len(state._arrivals[topics.POWER_MEASURED]) <= MOST_ARRIVALS
    assert state.rate(topics.POWER_MEASURED, 100.0 + 0.03 * MOST_ARRIVALS) == pytest.approx(
        100, 0.01
    )


def test_values_that_are_no_numbers_are_unknown():
    state = LiveState()
    message = said("/ev/estimator: estimate", Level.OK, "", **{"progress.eta": "much"})
    state.take(topics.DIAGNOSTICS, message, 1.0)
    assert math.isnan(state.parameters()[0].progress)


def test_a_message_with_nan_is_counted_and_changes_nothing(well):
    state = well(110.0)
    bad = named_vector(new_message, 10**9, ["power"], [1.0])
    bad.position[0] = math.nan
    state.take(topics.POWER_MEASURED, bad, 110.1)
    assert state.power(topics.POWER_MEASURED, 110.1).value == 14600.0
    ((level, text),) = state.problems(110.1)
    assert level is Level.WARN and text.startswith("power/measured: 1 ")
