import math

import pytest

from evpinn_ros import topics
from evpinn_ros.bags.types import new_message
from evpinn_ros.nodes.live.data import MOST_ARRIVALS, MOST_PARTS, STALE_AFTER, LiveData
from evpinn_ros.topics.messages import Level, diagnostics, named_vector


def said(name, level, text, **values):
    return diagnostics(new_message, 10**9, [(name, level, text, values)])


def test_what_is_heard_is_known(well):
    data = well(110.0)
    eta, mu = data.parameters()[:2]
    assert eta == ("eta", 0.912, pytest.approx(0.0456), 0.456, 1.824, 0.25, 87.0, "valid")
    assert math.isnan(mu.progress) and mu.state == ""
    assert data.power(topics.POWER_PREDICTED, 110.0) == (13900.0, 1200.0)
    assert math.isnan(data.power(topics.POWER_MEASURED, 110.0).sigma)
    assert data.fresh_battery(110.0).current == pytest.approx(-41.5)
    assert data.seen()[0][0] == 12 and data.seen()[1][4] == 3400
    assert math.isnan(data.seen()[2][0])
    assert data.band_coverage() == 0.893
    assert data.problems(110.0) == []


def test_silence_is_shown_and_named(well):
    data, late = well(110.0), 110.0 + STALE_AFTER
    assert math.isnan(data.fresh_speed(late)) and data.fresh_battery(late) is None
    assert math.isnan(data.power(topics.POWER_MEASURED, late).value)
    assert data.activity(late) == ""
    ((level, text),) = data.problems(late)
    assert level is Level.ERROR and text.startswith("estimator: ") and "3 s" in text
    assert data.parameters()[0].value == 0.912  # what was learned holds


def test_reasons_come_from_diagnostics_the_worst_first(well):
    data = well(110.0)
    data.take(topics.DIAGNOSTICS, said("/ev/energy: meter", Level.WARN, "predicting"), 110.0)
    data.take(topics.DIAGNOSTICS, said("/ev/can_bridge: bus", Level.ERROR, "lost"), 110.0)
    assert data.problems(110.0) == [
        (Level.ERROR, "can_bridge: bus: lost"),
        (Level.WARN, "energy: meter: predicting"),
    ]
    data.take(topics.DIAGNOSTICS, said("/ev/can_bridge: bus", Level.OK, "receiving"), 110.5)
    assert data.problems(110.5) == [(Level.WARN, "energy: meter: predicting")]


def test_each_view_shows_the_diagnostics_of_its_own_car():
    near, far = LiveData("/robot1/ev"), LiveData("/robot2/ev")
    message = said("/robot1/ev/can_bridge: bus", Level.ERROR, "lost")
    for data in (near, far):
        data.take(topics.DIAGNOSTICS, message, 1.0)
    assert near.problems(1.0) == [(Level.ERROR, "can_bridge: bus: lost")]
    assert far.statuses == {}
    ((_, text),) = far.problems(1.0)
    assert text.endswith("nodes run under /robot1/ev (--namespace)")


def test_parts_without_end_fill_no_memory():
    data = LiveData()
    for number in range(10 * MOST_PARTS):
        message = said(f"/ev/estimator: part {number}", Level.OK, "")
        data.take(topics.DIAGNOSTICS, message, 1.0)
    assert len(data.statuses) == MOST_PARTS
    assert data.unusable[topics.DIAGNOSTICS.name] == 9 * MOST_PARTS
    data.take(topics.DIAGNOSTICS, said("/ev/estimator: part 0", Level.WARN, "well known"), 1.0)
    assert (Level.WARN, "estimator: part 0: well known") in data.problems(1.0)


def test_messages_that_nobody_counts_fill_no_memory():
    """No rate is shown of most topics, and of none where there is no terminal."""
    data, message = LiveData(), named_vector(new_message, 10**9, ["power"], [1.0])
    for number in range(3 * MOST_ARRIVALS):
        data.take(topics.POWER_MEASURED, message, 100.0 + 0.01 * number)
    assert len(data._arrivals[topics.POWER_MEASURED]) <= MOST_ARRIVALS
    assert data.rate(topics.POWER_MEASURED, 100.0 + 0.03 * MOST_ARRIVALS) == pytest.approx(
        100, 0.01
    )


def test_a_message_with_nan_is_counted_and_changes_nothing(well):
    data = well(110.0)
    bad = named_vector(new_message, 10**9, ["power"], [1.0])
    bad.position[0] = math.nan
    data.take(topics.POWER_MEASURED, bad, 110.1)
    assert data.power(topics.POWER_MEASURED, 110.1).value == 14600.0
    ((level, text),) = data.problems(110.1)
    assert level is Level.WARN and text.startswith("power/measured: 1 ")
