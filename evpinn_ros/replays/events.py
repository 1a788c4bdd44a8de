"""Events of a drive, such as gaps, jumps of time and changes of payload."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.detector import CURRENT_SIGN, GRADE_SIGN
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.time_jump import DEFAULT_RULE
from evpinn_ros.replays.history import Detection, Drive
from evpinn_ros.replays.scoring import longest_step

CLOCK_STEP = DEFAULT_RULE.threshold
FAULT_TEXTS = {
    CURRENT_SIGN: "Accelerating charges the battery: is the sign of current wrong?",
    GRADE_SIGN: "Climbing gives power back: is the sign of grade or pitch wrong?",
}


class EventKind(str, Enum):
    """Kind of an event."""

    PAYLOAD = "payload"
    SIGNAL_FAULT = "signal fault"
    SPEED_DROPOUT = "speed dropout"
    BATTERY_DROPOUT = "battery dropout"
    RESET = "time reset"
    WITHHELD = "battery withheld"


class Event(NamedTuple):
    """An event at a time, s since the first reading."""

    time: float
    kind: EventKind
    text: str


def drive_events(drive: Drive, withheld_from: float | None = None) -> list[Event]:
    """The events of a drive in order of time; the battery is withheld from `withheld_from`, s."""
    events = [*_gaps(drive), *_resets(drive), *_payloads(drive), *_signal_faults(drive.detections)]
    if withheld_from is not None and withheld_from < drive.duration:
        text = "From here on the battery was hidden from the estimator."
        events.append(Event(withheld_from, EventKind.WITHHELD, text))
    return sorted(events, key=lambda event: event.time)


def _gaps(drive: Drive) -> Iterator[Event]:
    for kind, rows, lost in (
        (EventKind.SPEED_DROPOUT, drive.speed, "nothing was predicted or learned across it"),
        (EventKind.BATTERY_DROPOUT, drive.measured, "power was predicted from speed alone"),
    ):
        known = np.sort(rows[:, 0])
        times = np.concatenate(([0.0], known, [drive.duration]))
        for index in np.flatnonzero(np.diff(times) > longest_step(known)):
            seconds = times[index + 1] - times[index]
            yield Event(float(times[index]), kind, f"For {seconds:.1f} s; {lost}.")


def _resets(drive: Drive) -> Iterator[Event]:
    times = drive.speed[:, 0]  # in a recording of the nodes they may still go back
    steps = np.diff(times)
    recorded = ((times[i + 1], -steps[i]) for i in np.flatnonzero(steps < -CLOCK_STEP))
    for time, back in (*drive.jumps, *recorded):
        text = f"Stamps went back by {back:.0f} s; integrals over time restart."
        yield Event(float(time), EventKind.RESET, text)


def _payloads(drive: Drive) -> Iterator[Event]:
    """The last reported change of payload of each drive."""
    changes = (detection.report.payload_change for detection in drive.detections)
    last = {change.stamp_ns: change for change in changes if change is not None}
    for stamp_ns, change in last.items():
        text = f"{change.delta_mass:+.0f} ± {change.std:.0f} kg since the drive before."
        yield Event((stamp_ns - drive.start_ns) / NANOSECONDS, EventKind.PAYLOAD, text)


def _signal_faults(detections: tuple[Detection, ...]) -> Iterator[Event]:
    before: str | None = None
    for time, report in detections:
        if report.suspicion != before:
            text = "The signals agree again."
            if report.suspicion is not None:
                text = FAULT_TEXTS.get(report.suspicion, report.suspicion)
            yield Event(time, EventKind.SIGNAL_FAULT, text)
        before = report.suspicion
