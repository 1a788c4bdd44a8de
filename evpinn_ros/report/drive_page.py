"""The report of one drive or several: what was measured, learned, known, forecast."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from evpinn_ros.energy.quadrature import trapezoid
from evpinn_ros.replay.events import Event, EventKind, drive_events
from evpinn_ros.replay.forecasts import ForecastOutcome, forecast_outcomes
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
from evpinn_ros.report.breakdown_bar import breakdown_section
from evpinn_ros.report.drive_knowledge import knowledge
from evpinn_ros.report.html import table, write_page
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
    if len(drives) == 1:
        title = f"Drive {drives[0].name}"
        sections = [f"<div data-drive='0'>{found[0][0]}</div>"]
    else:
        title = f"{len(drives)} drives"
        sections = [
            f"<details data-drive='{index}'{' open' if index == 0 else ''}>"
            f"<summary>{escape(reported.name)}</summary>{section}</details>"
            for index, (reported, (section, _)) in enumerate(zip(drives, found, strict=True))
        ]
    write_page(path, title, command, [*sections, _FOOTER], [plots for _, plots in found])


def _drive(reported: ReportedDrive, points: int) -> tuple[str, dict[str, Any]]:
    """One drive as HTML, and what the page's script draws into it."""
    drive = reported.drive
    events = drive_events(drive, reported.withheld_from)
    parts = forecast_outcomes(drive, reported.vehicle.air_density)
    moments = drive_maps.moments(drive)
    charts = dict(_curves(reported, points)) | dict(_maps(reported, moments))
    if parts:
        charts["outcome"] = drive_charts.outcome_chart(parts)
    shaded = [[0.0, min(reported.warm_up, drive.duration)]]
    if reported.withheld_from is not None:
        shaded.append([reported.withheld_from, drive.duration])
    html = "\n".join(
        (
            _summary(reported, events),
            _course(events),
            _learned(charts),
            knowledge(reported.vehicle, drive, drive_maps.driven_minutes(moments)),
            _where(charts),
            _forecasts(parts),
            _events(events),
        )
    )
    return html, {
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


def _summary(reported: ReportedDrive, events: Sequence[Event]) -> str:
    """The page to print: scores, baselines beside them, parameters with their state."""
    drive, found = reported.drive, reported.found
    dropped = ", ".join(f"{n} {why}" for why, n in found["input"]["dropped"].items())
    lines = [
        f"{reported.vehicle.name}, mode {found['mode']}. {found['input']['path']}",
        f"Began {_date(drive.start_ns)}; {found['input']['samples']} samples; "
        f"dropped readings: {dropped or 'none'}; events: {len(events) or 'none'}.",
    ]
    scores = (
        f"<h3>Predict, then update; after {reported.warm_up:.0f} s</h3>"
        + table(SCORE_COLUMNS, score_rows(drive, found, reported.warm_up))
        + "".join(f"<p>{escape(line)}</p>" for line in energy_lines(found))
        + "<p class='muted'>No prediction knows the sample that scores it. The baselines know "
        "nothing of cars: at 10 Hz the last value held is hard to beat, and worth nothing once "
        "the battery is silent; a random split proves interpolation, not prediction.</p>"
    )
    parameters = (
        "<h3>Parameters at the end</h3>"
        + table(parameter_columns(reported.truth), parameter_rows(found, reported.truth))
        + "<p class='muted'>Prior: share of the prior in the value. 100 % means that "
        "the data did not inform it.</p>"
    )
    return (
        "<section class='first'>"
        + "".join(f"<p class='muted'>{escape(line)}</p>" for line in lines)
        + breakdown_section(found["breakdown"])
        + f"<div class='tiles'>{''.join(_tiles(reported, events))}</div>"
        + f"<div class='pair'><div>{scores}</div><div>{parameters}</div></div></section>"
    )


def _tiles(reported: ReportedDrive, events: Sequence[Event]) -> Iterator[str]:
    drive, found = reported.drive, reported.found
    energy, power = found["energy"], found["power"]
    distance = _distance(drive)
    yield _tile(str(timedelta(seconds=round(drive.duration))), f"for {distance:.1f} km")
    yield _tile(watt_hours(energy["measured_j"]), "energy measured")
    yield _tile(signed_percent(energy["error_percent"]), "error of the energy predicted")
    whole = not any(event.kind in PARTIAL for event in events)
    if energy["measured_j"] is not None and whole and distance >= 1.0:
        consumption = energy["measured_j"] / 3600 / distance
        yield _tile(f"{consumption:.0f} Wh/km", "consumption")
    held = watts(baseline_scores(drive, Span(reported.warm_up, drive.duration))["last_value"])
    yield _tile(watts(power["rmse_w"]), f"RMSE of power; last value held: {held}")
    covered = power["coverage_90"]
    yield _tile("-" if covered is None else f"{100 * covered:.1f} %", "of power in its 90 % band")


def _tile(value: str, label: str) -> str:
    return f"<div class='tile'><b>{escape(value)}</b><span>{escape(label)}</span></div>"


def _figure(key: str, title: str, text: str = "", readout: str = "") -> str:
    below = ""
    if readout:
        rest = escape(readout)
        below = f"<div class='readout' data-rest='{rest}'>{rest}</div>"
    return (
        f"<figure><figcaption><b>{escape(title)}</b> {escape(text)}</figcaption>"
        f"<div class='plot' data-plot='{key}'></div>{below}</figure>"
    )


def _course(events: Sequence[Event]) -> str:
    marks = " Dashed lines are the events below." if events else ""
    return (
        "<h2>The drive</h2><p class='muted screen'>Drag sideways to zoom; all curves over time "
        "follow. <button type='button'>Whole drive</button></p>"
        + _figure("speed", "Speed.", f"Shaded: warm-up or withheld battery.{marks}")
        + _figure("power", "Battery power", "measured, and predicted with its 90 % band.")
        + _figure("error", "Error of power:", "predicted less measured, in the band claimed.")
        + _figure(
            "energy",
            "Energy",
            "since the start; measured stands still while the battery is silent.",
        )
    )


def _learned(charts: Mapping[str, Any]) -> str:
    figures = "".join(
        _figure(name, title) for name, title in drive_charts.TITLES.items() if name in charts
    )
    if not figures:
        return "<h2>What was learned</h2><p>Nothing: there was too little to learn from.</p>"
    return (
        "<h2>What was learned</h2><p>Each parameter with its 1-sigma band. A curve that moves "
        "while its band stays wide follows its prior and the other parameters, not the data.</p>"
        f"<div class='pair'>{figures}</div>"
    )


def _where(charts: Mapping[str, Any]) -> str:
    if "coverage" not in charts:
        return "<h2>Data coverage</h2><p>The battery was not measured on this drive.</p>"
    rest = f"Point at a cell for its value. Full colour: {charts['coverage']['full']:.0f} s."
    figures = _figure("coverage", "Where the data lay:", "time in each cell.", rest)
    if "errors" in charts:
        text = "mean error; blue: too low, red: too high."
        rest = f"Point at a cell for its value. Full colour: {charts['errors']['full']:.2f} kW."
        figures += _figure("errors", "Where power was off:", text, rest)
        figures += _figure("over_speed", "Error over speed:", "median and 90 % of each bin.")
        figures += _figure("over_acceleration", "Error over acceleration:", "likewise.")
    return (
        "<h2>Where the data lay, and where predictions were off</h2><p>Outside of the coloured "
        "cells the car was never seen: values there are extrapolated. Errors are of "
        f"power/smoothed less measured power.</p><div class='pair'>{figures}</div>"
    )


def _forecasts(parts: Sequence[ForecastOutcome]) -> str:
    title = "<h2>Forecast against outcome</h2>"
    if not parts:
        return f"{title}<p>No part of this drive was whole and long enough, or had a model.</p>"
    held = sum(part.covered for part in parts)
    return (
        f"{title}<p>Every five minutes the next part of the drive is asked of the car as it was "
        "known then, as a planner would: speed once a second, altitude where recorded, flat where "
        f"not, and nothing of the battery. {held} of {len(parts)} outcomes lie in the 90 % band."
        f"</p>{_figure('outcome', 'Energy of each part', 'forecast with its band; measured.')}"
    )


def _events(events: Sequence[Event]) -> str:
    if not events:
        return "<h2>Events</h2><p>None: no gap, no change of payload, no signal fault.</p>"
    rows = [
        (str(timedelta(seconds=round(event.time))), event.kind.value, event.text)
        for event in events[:MOST_EVENTS]
    ]
    more = len(events) - len(rows)
    rest = f"<p>And {more} more.</p>" if more else ""
    return f"<h2>Events</h2>{table(('time', 'what', ''), rows)}{rest}"


def _distance(drive: Drive) -> float:
    """Distance driven, km."""
    time, speed = drive.speed[np.argsort(drive.speed[:, 0], kind="stable")].T
    return trapezoid(np.abs(speed), time) / 1000


def _date(stamp_ns: int) -> str:
    if not 0 <= stamp_ns <= LAST_STAMP:
        return "at an impossible time"
    return (EPOCH + timedelta(seconds=stamp_ns // 10**9)).strftime("%Y-%m-%d %H:%M:%S UTC")


_FOOTER = (
    "<footer class='muted'>SI units unless stated. Power and energy are positive when drawn from "
    "the battery. Plots: uPlot, MIT licence, within this file.</footer>"
)
