"""The report of one drive or several: what was measured, learned, known, forecast."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np

from evpinn_ros.energy.quadrature import trapezoid
from evpinn_ros.replay.breakdown_text import COLUMNS
from evpinn_ros.replay.events import Event, EventKind, drive_events
from evpinn_ros.replay.forecasts import forecast_outcomes
from evpinn_ros.replay.history import Drive
from evpinn_ros.replay.scoring import Span, baseline_scores
from evpinn_ros.replay.tables import (
    SCORE_COLUMNS,
    energy_lines,
    parameter_columns,
    parameter_rows,
    score_rows,
    signed_percent,
    watt_hours,
    watts,
)
from evpinn_ros.report import drive_charts, drive_maps
from evpinn_ros.report.breakdown_bar import breakdown_values
from evpinn_ros.report.drive_knowledge import knowledge
from evpinn_ros.report.html import write_page
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.parameters import Parameters

POINTS = 40_000  # of a curve, all drives of a page together: an hour at 10 Hz loses nothing
LEAST_POINTS = 2_000  # of a curve of one of many drives
SMALL = 4  # times fewer points for parameters, which come once a second and change slowly
MOST_EVENTS = 200  # shown
# With these, energy measured is of a part of the drive, and distance of another.
PARTIAL = (EventKind.SPEED_DROPOUT, EventKind.BATTERY_DROPOUT, EventKind.WITHHELD, EventKind.RESET)
EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
LAST_STAMP = 253_402_300_799 * 10**9  # ns, the end of the year 9999: a calendar has no more


@dataclass(frozen=True, slots=True)
class ReportedDrive:
    """A drive to report.

    Attributes:
        drive: its series.
        found: its metrics (`scoring.metrics`).
        vehicle: whose drive it is.
        warm_up: s at the start that were not scored.
        withheld_from: s from which on the battery was withheld, None if it was not.
        truth: true parameters of a simulated car.
    """

    drive: Drive
    found: Mapping[str, Any]
    vehicle: Vehicle
    warm_up: float
    withheld_from: float | None = None
    truth: Parameters | None = None

    @property
    def name(self) -> str:
        """Of the file or folder it came from."""
        path = Path(self.found["input"]["path"])
        return path.name or path.resolve().name


def write_drives(path: Path, drives: Sequence[ReportedDrive], command: str) -> None:
    """Write the report; of several drives each can be opened, the first is open."""
    points = max(POINTS // len(drives), LEAST_POINTS)
    found = [_drive(reported, points) for reported in drives]
    write_page(
        path,
        "drive.html.j2",
        title=f"Drive {drives[0].name}" if len(drives) == 1 else f"{len(drives)} drives",
        command=command,
        plots=[plots for _, plots in found],
        drives=[values for values, _ in found],
        score_columns=SCORE_COLUMNS,
        breakdown_columns=COLUMNS,
        parameter_titles=drive_charts.TITLES,
        most_events=MOST_EVENTS,
    )


def _drive(reported: ReportedDrive, points: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """One drive for the template, and what the page's script draws into it."""
    drive, found = reported.drive, reported.found
    events = drive_events(drive, reported.withheld_from)
    parts = forecast_outcomes(drive, reported.vehicle.air_density)
    moments = drive_maps.moments(drive)
    charts = dict(_curves(reported, points)) | dict(_maps(reported, moments))
    if parts:
        charts["outcome"] = drive_charts.outcome_chart(parts)
    shaded = [[0.0, min(reported.warm_up, drive.duration)]]
    if reported.withheld_from is not None:
        shaded.append([reported.withheld_from, drive.duration])
    values = {
        "name": reported.name,
        "lines": _lines(reported, events),
        "breakdown": breakdown_values(found["breakdown"]),
        "tiles": list(_tiles(reported, events)),
        "warm_up": f"{reported.warm_up:.0f}",
        "scores": score_rows(drive, found, reported.warm_up),
        "energy_lines": energy_lines(found),
        "parameter_columns": parameter_columns(reported.truth),
        "parameters": parameter_rows(found, reported.truth),
        "charts": charts,
        "knowledge": knowledge(reported.vehicle, drive, drive_maps.driven_minutes(moments)),
        "forecasts": parts,
        "events": [(_clock(event.time), event.kind.value, event.text) for event in events],
    }
    return values, {
        "duration": drive.duration,
        "events": [event.time for event in events[:MOST_EVENTS]],
        "shaded": shaded,
        "charts": charts,
    }


def _curves(reported: ReportedDrive, points: int) -> Iterator[tuple[str, drive_charts.Chart]]:
    drive = reported.drive
    yield "speed", drive_charts.speed_chart(drive, points)
    yield "power", drive_charts.power_chart(drive, points)
    yield "error", drive_charts.error_chart(drive, points) | {"height": 160}
    yield "energy", drive_charts.energy_chart(drive, points // SMALL)
    if drive.final is None:
        return
    for name in drive.parameters:
        chart = drive_charts.parameter_chart(drive, name, reported.truth, points // SMALL)
        yield name, chart | {"height": 170}
    yield "shares", drive_charts.share_chart(drive, points // SMALL)


def _maps(
    reported: ReportedDrive, moments: drive_maps.Moments
) -> Iterator[tuple[str, drive_maps.Chart]]:
    if not len(moments.time):
        return
    yield "coverage", drive_maps.coverage_map(moments)
    counted = drive_maps.scored_moments(reported.drive, moments, reported.warm_up)
    if len(counted.time):
        yield "errors", drive_maps.error_map(counted)
        yield "over_speed", drive_maps.spread_chart(counted, "speed")
        yield "over_acceleration", drive_maps.spread_chart(counted, "acceleration")


def _lines(reported: ReportedDrive, events: Sequence[Event]) -> list[str]:
    drive, found = reported.drive, reported.found
    dropped = ", ".join(f"{n} {why}" for why, n in found["input"]["dropped"].items())
    return [
        f"{reported.vehicle.name}, mode {found['mode']}. {found['input']['path']}",
        f"Began {_date(drive.start_ns)}; {found['input']['samples']} samples; "
        f"dropped readings: {dropped or 'none'}; events: {len(events) or 'none'}.",
    ]


def _tiles(reported: ReportedDrive, events: Sequence[Event]) -> Iterator[tuple[str, str]]:
    """Values with what they are."""
    drive, found = reported.drive, reported.found
    energy, power = found["energy"], found["power"]
    distance = _distance(drive)
    yield (_clock(drive.duration), f"for {distance:.1f} km")
    yield (watt_hours(energy["measured_j"]), "energy measured")
    yield (signed_percent(energy["error_percent"]), "error of the energy predicted")
    whole = not any(event.kind in PARTIAL for event in events)
    if energy["measured_j"] is not None and whole and distance >= 1.0:
        consumption = energy["measured_j"] / 3600 / distance
        yield (f"{consumption:.0f} Wh/km", "consumption")
    held = watts(baseline_scores(drive, Span(reported.warm_up, drive.duration))["last_value"])
    yield (watts(power["rmse_w"]), f"RMSE of power; last value held: {held}")
    covered = power["coverage_90"]
    yield ("-" if covered is None else f"{100 * covered:.1f} %", "of power in its 90 % band")


def _distance(drive: Drive) -> float:
    """Distance driven, km."""
    time, speed = drive.speed[np.argsort(drive.speed[:, 0], kind="stable")].T
    return trapezoid(np.abs(speed), time) / 1000


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))


def _date(stamp_ns: int) -> str:
    if not 0 <= stamp_ns <= LAST_STAMP:
        return "at an impossible time"
    return (EPOCH + timedelta(seconds=stamp_ns // 10**9)).strftime("%Y-%m-%d %H:%M:%S UTC")
