"""Events of a drive, from series made by hand."""

import numpy as np

from evpinn_ros.core.estimation.learner import LearnerReport
from evpinn_ros.core.estimation.payload import PayloadChange
from evpinn_ros.core.signals.detector import CURRENT_SIGN
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.replays.events import EventKind, drive_events
from evpinn_ros.replays.history import Detection, Drive
from test.replays.conftest import made

START_NS = 1_700_000_000 * NANOSECONDS


def drive(speed=None, measured=None, detections=()) -> Drive:
    """A minute of one reading a second, or at the times that are given."""
    whole = np.arange(61.0)
    rows = [
        np.stack((times, np.zeros(len(times))), axis=1)
        for times in (np.array(whole if t is None else t, float) for t in (speed, measured))
    ]
    told = tuple(Detection(time, report) for time, report in detections)
    return made(speed=rows[0], measured=rows[1], start_ns=START_NS, detections=told)


def kinds(events) -> list[tuple[float, EventKind]]:
    return [(event.time, event.kind) for event in events]


def test_gaps_are_events_at_the_ends_too():
    speed = [t for t in range(61) if not 20 < t < 30]
    events = drive_events(drive(speed, range(8, 51)))
    assert kinds(events) == [
        (0.0, EventKind.BATTERY_DROPOUT),
        (20.0, EventKind.SPEED_DROPOUT),
        (50.0, EventKind.BATTERY_DROPOUT),
    ]
    assert "10.0 s" in events[1].text


def test_a_log_of_a_reading_every_five_seconds_has_no_dropout_in_it():
    """An app's log: what is a gap is so by the usual step of the log itself."""
    slow = [t for t in range(0, 61, 5) if not 20 < t < 55]
    assert drive_events(drive(range(0, 61, 5), range(0, 61, 5))) == []
    assert kinds(drive_events(drive(range(0, 61, 5), slow))) == [(20.0, EventKind.BATTERY_DROPOUT)]


def test_a_battery_that_never_spoke_is_one_event():
    assert kinds(drive_events(drive(measured=[]))) == [(0.0, EventKind.BATTERY_DROPOUT)]


def test_stamps_that_go_back_are_a_reset_and_stragglers_none():
    straggling = [0, 1, 2, 4, 3, *range(5, 61)]
    assert drive_events(drive(straggling)) == []
    events = drive_events(drive([*range(61), *range(30, 61)]))
    assert kinds(events) == [(30.0, EventKind.RESET)] and "30 s" in events[0].text


def test_a_payload_is_told_once_as_it_was_known_last():
    stop = START_NS + 10 * NANOSECONDS
    changes = [PayloadChange(stop, mass, std) for mass, std in ((150.0, 40.0), (180.0, 25.0))]
    reports = [LearnerReport(change) for change in changes]
    events = drive_events(
        drive(detections=[(0.0, LearnerReport()), (40.0, reports[0]), (41.0, reports[1])])
    )
    assert kinds(events) == [(10.0, EventKind.PAYLOAD)]
    assert "+180 ± 25 kg" in events[0].text


def test_suspicions_come_and_go():
    suspected = LearnerReport(suspicion=CURRENT_SIGN)
    events = drive_events(
        drive(detections=[(0.0, LearnerReport()), (20.0, suspected), (40.0, LearnerReport())])
    )
    assert kinds(events) == [(20.0, EventKind.SIGNAL_FAULT), (40.0, EventKind.SIGNAL_FAULT)]
    assert "sign of current" in events[0].text


def test_a_withheld_battery_is_an_event_if_it_came_to_that():
    assert kinds(drive_events(drive(), 30.0)) == [(30.0, EventKind.WITHHELD)]
    assert drive_events(drive(), 90.0) == []
