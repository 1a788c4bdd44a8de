"""The page of `evpinn replay --report`: measurements, scores, parameters, forecasts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, Units, fixed
from evpinn_ros.core.energy.charge import ChargeGauge
from evpinn_ros.core.estimation.breakdown import CONSUMPTION_METRES
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.identifiable import prior_identifiable
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.replays.drive_names import short_names
from evpinn_ros.replays.driven import DrivenSteps, counted, measured_steps, travelled
from evpinn_ros.replays.events import drive_events
from evpinn_ros.replays.forecasts import forecast_outcomes
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.run import Replayed, ReplayOptions
from evpinn_ros.replays.scoring import Span, baseline_scores
from evpinn_ros.replays.simulation.truth_file import read_truth
from evpinn_ros.replays.trends import drive_point
from evpinn_ros.report import drive_charts, drive_maps
from evpinn_ros.report.drive_charts import breakdown_values, running_totals, speed_energy_chart
from evpinn_ros.report.drive_maps import FAST_SPEED, SLOW_SPEED
from evpinn_ros.report.dropped_text import dropped_text
from evpinn_ros.report.html import write_page
from evpinn_ros.report.owner_text import (
    LEAST_CHARGED,
    NEARLY_WHOLE,
    drives_columns,
    drives_rows,
    health_line,
    lone_note,
    owner_notes,
    part_text,
    scores_note,
)
from evpinn_ros.report.shapes import trend_intervals
from evpinn_ros.report.tables import (
    SCORE_COLUMNS,
    energy_lines,
    parameter_columns,
    parameter_rows,
    score_rows,
    signed_percent,
    watts,
)

POINTS = 40_000  # of a curve, all drives of a page together: an hour at 10 Hz loses nothing
LEAST_POINTS = 2_000  # of a curve of one of many drives
SMALL = 4  # times fewer points for curves that change slowly
MOST_EVENTS = 200  # shown
ZONES = " UTC", ", local time"
DATED_AT = 5  # column of the date in the list of drives: narrow screens cut off the last columns
EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
LAST_STAMP = 253_402_300_799 * NANOSECONDS  # end of the year 9999, the last of datetime


Charts: TypeAlias = Iterator[tuple[str, drive_charts.Chart]]
COMBINATIONS = {  # label, format of the value, and the driving that determines it
    "mass_over_eta": ("mass / η", "{:.0f} kg", "speeding up and braking, over 0.5 m/s²"),
    "drag_area_over_eta": ("A C_d / η", "{:.4f} m²", "above {fast}"),
    "c_rr": ("C_rr", "{:.5f}", "steady, {slow} to {fast}"),
    "regeneration": ("η μ", "{:.3f}", "braking over 0.5 m/s²"),
    "p_aux": ("auxiliary power", "{:.0f} W", "below {slow}"),
}


@dataclass(frozen=True, slots=True)
class ReportedDrive:
    """A drive to report."""

    drive: Drive
    metrics: Mapping[str, Any]  # from `scoring.metrics`
    vehicle: Vehicle
    warm_up: float  # s at the start that were not scored
    withheld_from: float | None = None  # s from which on the battery was withheld
    truth: Parameters | None = None  # true parameters of a simulated car


def write_replayed(
    path: Path,
    replays: Sequence[Replayed],
    vehicle: Vehicle,
    options: ReplayOptions,
    command: str,
    units: Units = METRIC,
    breakdown: Mapping[str, Any] | None = None,
    *,
    gauge: ChargeGauge,
    record: str | None = None,
) -> None:
    """Write the report of replayed drives, with the true parameters of simulated ones.

    `breakdown` is of all drives together, `gauge` shows the state of health, and `record` is a
    sentence on how well the drives were forecast. OSError: the page cannot be written.
    """
    drives = [
        ReportedDrive(
            drive=replayed.drive,
            metrics=replayed.metrics,
            vehicle=vehicle,
            warm_up=options.warm_up,
            withheld_from=options.withhold_battery_after,
            truth=read_truth(Path(replayed.metrics["input"]["path"])),
        )
        for replayed in replays
    ]
    health = health_line(gauge, [replayed.drive for replayed in replays])
    about_car = " ".join(filter(None, (health, record)))
    write_drives(path, drives, command, units, breakdown, about_car)


def write_drives(
    path: Path,
    drives: Sequence[ReportedDrive],
    command: str,
    units: Units = METRIC,
    breakdown: Mapping[str, Any] | None = None,
    health: str = "",
) -> None:
    """Write the report; several drives are collapsible sections, the first of them open.

    `breakdown` and `health`, sentences on the car, are of all drives together.
    """
    points = max(POINTS // len(drives), LEAST_POINTS)
    names = short_names([Path(drive.metrics["input"]["path"]) for drive in drives])
    pages = [
        _drive(name, reported, points, units) for name, reported in zip(names, drives, strict=True)
    ]
    rows = drives_rows(
        [(name, drive.drive, drive.metrics) for name, drive in zip(names, drives, strict=True)],
        breakdown,
        units,
    )
    columns = drives_columns(units)
    if any(drive.drive.dated for drive in drives):
        began = [_date(drive.drive) for drive in drives]
        zone = next((zone for zone in ZONES if all(begin.endswith(zone) for begin in began)), "")
        began = [*(begin.removesuffix(zone) for begin in began), ""]
        columns = (*columns[:DATED_AT], f"began{zone}", *columns[DATED_AT:])
        rows = [
            (*row[:DATED_AT], date, *row[DATED_AT:])
            for row, date in zip(rows, began, strict=False)
        ]
    write_page(
        path,
        "drive.html.j2",
        title=_title(names[0]) if len(drives) == 1 else f"{len(drives)} drives",
        command=command,
        plots=[plots for _, plots in pages],
        drives=[values for values, _ in pages],
        about=", ".join(dict.fromkeys(drive.vehicle.name for drive in drives)),
        index_columns=columns,
        index=rows,
        health=health,
        about_scores=scores_note(rows),
        whole=breakdown and {"breakdown": breakdown_values(breakdown, units)},
        trends=trend_intervals([drive_point(drive.drive) for drive in drives], units),
        score_columns=SCORE_COLUMNS,
        parameter_titles=drive_charts.TITLES,
        most_events=MOST_EVENTS,
    )


def _title(name: str) -> str:
    return name.capitalize() if name.lower().startswith(("drive", "trip")) else f"Drive {name}"


def _drive(
    name: str, reported: ReportedDrive, points: int, units: Units
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Values of one drive for the template, and for `browser/drive.js`."""
    drive, metrics = reported.drive, reported.metrics
    events = drive_events(drive, reported.withheld_from)
    steps = travelled(drive), measured_steps(drive)
    parts = forecast_outcomes(drive)
    moments = drive_maps.moments(drive)
    charts = dict(_curves(reported, steps[1], points, units))
    charts |= dict(_maps(reported, moments, units))
    if parts:
        charts["outcome"] = drive_charts.outcome_chart(parts)
    minutes = drive_maps.driven_minutes(moments)
    values = {
        "name": name,
        "about": f"{reported.vehicle.name}, {_date(drive)}",
        "doubts": [
            *filter(None, [lone_note(drive, units)]),
            *owner_notes(reported.vehicle, drive, metrics),
            *drive.reading_notes,
        ],
        "record": _record(metrics),
        "breakdown": breakdown_values(metrics["breakdown"], units),
        "tiles": list(drive_tiles(drive, units)),
        "warm_up": f"{reported.warm_up:.0f}",
        "score_tiles": list(_score_tiles(reported)),
        "scores": score_rows(drive, metrics, reported.warm_up),
        "energy_lines": energy_lines(metrics),
        "parameter_columns": parameter_columns(reported.truth),
        "parameters": parameter_rows(metrics, reported.truth),
        "charts": charts,
        "knowledge": knowledge(reported.vehicle, drive, minutes, units),
        "forecasts": parts,
        "events": [(clock(event.time), event.kind.value, event.text) for event in events],
    }
    return values, {
        "duration": drive.duration,
        "events": [event.time for event in events[:MOST_EVENTS]],
        "shaded": list(_shaded(reported)),
        "charts": charts,
        "totals": running_totals(*steps, drive.duration, points // SMALL),
        "units": units._asdict(),
    }


def _shaded(reported: ReportedDrive) -> Iterator[tuple[float, float]]:
    yield 0.0, min(reported.warm_up, reported.drive.duration)
    if reported.withheld_from is not None:
        yield reported.withheld_from, reported.drive.duration


def _curves(reported: ReportedDrive, measured: DrivenSteps, points: int, units: Units) -> Charts:
    drive, few = reported.drive, points // SMALL
    yield "by_speed", speed_energy_chart(drive, reported.vehicle, measured, units)
    if len(drive.position) > 1:
        yield "map", drive_maps.route_map(drive, measured, units)
    speed = drive.speed * (1.0, units.speeds)
    yield "speed", drive_charts.line_chart(drive, "speed", f"speed, {units.speed}", speed, points)
    yield "power", drive_charts.power_chart(drive, points)
    height = drive.altitude * (1.0, 1.0 / units.height_metres)
    temperature = drive.temperature * (1.0, units.degrees) + (0.0, units.zero)
    for name, axis, rows in (
        ("height", f"height, {units.height}", height),
        ("charge", "charge, %", drive.charge * (1.0, 100.0)),
        ("temperature", f"outside, {units.temperature}", temperature),
    ):
        if len(rows):
            yield name, drive_charts.line_chart(drive, name, axis, rows, few) | {"height": 130}
    yield "error", drive_charts.error_chart(drive, points) | {"height": 160}
    yield "energy", drive_charts.energy_chart(drive, measured, few)
    if drive.final is None:
        return
    for name in drive.parameters:
        chart = drive_charts.parameter_chart(drive, name, reported.truth, few)
        yield name, chart | {"height": 170}
    yield "shares", drive_charts.share_chart(drive, few)


def _maps(reported: ReportedDrive, moments: drive_maps.MeasuredMoments, units: Units) -> Charts:
    if not len(moments.time):
        return
    yield "coverage", drive_maps.coverage_map(moments, units)
    counted = drive_maps.scored_moments(reported.drive, moments, reported.warm_up)
    if len(counted.time):
        yield "errors", drive_maps.error_map(counted, units)
        yield "over_speed", drive_maps.spread_chart(counted, "speed", units)
        yield "over_acceleration", drive_maps.spread_chart(counted, "acceleration", units)


def _record(metrics: Mapping[str, Any]) -> str:
    dropped = dropped_text(metrics["input"]["dropped"])
    return (
        f"{metrics['input']['path']}, mode {metrics['mode']}; "
        f"{metrics['input']['samples']} samples; not used: {dropped or 'nothing'}."
    )


def _score_tiles(reported: ReportedDrive) -> Iterator[tuple[str, str]]:
    drive, power = reported.drive, reported.metrics["power"]
    error = reported.metrics["energy"]["error_percent"]
    yield signed_percent(error), "error of the predicted energy"
    held = watts(baseline_scores(drive, Span(reported.warm_up, drive.duration))["last_value"])
    yield watts(power["rmse_w"]), f"RMSE of power; last value held: {held}"
    covered = power["coverage_90"]
    yield "-" if covered is None else f"{100 * covered:.1f} %", "of power in its 90 % band"


def _date(drive: Drive) -> str:
    stamp_ns, zone = drive.start_ns, ZONES[not drive.zoned]
    if not 0 <= stamp_ns <= LAST_STAMP:
        return "at an impossible time"
    if not drive.dated:
        return "undated"
    begin = EPOCH + timedelta(seconds=stamp_ns // NANOSECONDS)
    return f"{begin:%Y-%m-%d %H:%M:%S}{zone}"


def drive_tiles(drive: Drive, units: Units) -> Iterator[tuple[str, str]]:
    """(value, label) of each tile: energy over distance first, then the drive's other figures."""
    total = counted(drive)
    if total.known >= CONSUMPTION_METRES:
        whole = total.known > NEARLY_WHOLE * total.distance
        part = "" if whole else f", over {_distance(total.known, units)} measured"
        yield units.consumption(total.energy, total.known), f"{units.economy}{part}"
    if total.measured:
        whole = total.measured >= NEARLY_WHOLE * drive.duration
        part = "" if whole else f", {part_text(total.measured, drive.duration)} read"
        yield f"{total.energy / JOULES_PER_KWH:.3g} kWh", f"from the battery{part}"
    if total.charged >= LEAST_CHARGED:
        yield (
            f"{total.charged / JOULES_PER_KWH:.3g} kWh",
            "charged while parked, not included elsewhere",
        )
    mean = total.distance / total.seconds * units.speeds if total.seconds else 0.0
    time = clock(drive.duration)
    if total.seconds < NEARLY_WHOLE * drive.duration:
        time = f"{clock(total.seconds)} recorded of {time}"
    yield _distance(total.distance, units), f"in {time}, {mean:.0f} {units.speed} on average"
    if len(drive.charge):
        begin, end = 100 * drive.charge[0, 1], 100 * drive.charge[-1, 1]
        yield f"{begin:.0f} to {end:.0f} %", "state of charge"
    if len(drive.altitude):
        heights = drive.altitude[:, 1] / units.height_metres
        rise = f"{fixed(heights[-1] - heights[0], 0, '+')} {units.height}"
        yield rise, f"end above start; {heights.min():.0f} to {heights.max():.0f} {units.height}"
    if len(drive.temperature):
        celsius = drive.temperature[:, 1]
        low, high = (
            limit * units.degrees + units.zero for limit in (celsius.min(), celsius.max())
        )
        degrees = f"{low:.0f}" if round(low) == round(high) else f"{low:.0f} to {high:.0f}"
        yield f"{degrees} {units.temperature}", "outside"


def clock(seconds: float) -> str:
    """A duration as h:mm:ss."""
    return str(timedelta(seconds=round(seconds)))


def _distance(metres: float, units: Units) -> str:
    return f"{metres / units.metres:.1f} {units.distance}"


class CombinationRow(NamedTuple):
    """What is known of an identifiable combination at the end of a drive."""

    label: str
    value: str  # with its 1-sigma
    left: int  # 1-sigma, percent of the prior's
    learned_by: str  # driving that determines it
    minutes: str  # of such driving


def knowledge(
    vehicle: Vehicle, drive: Drive, minutes: Mapping[str, float], units: Units
) -> list[CombinationRow]:
    """A row for each combination; `minutes` are those of `driven_minutes`."""
    before = prior_identifiable(vehicle)[1]._asdict()
    return [
        _combination_row(name, drive.combinations[name][-1], before[name], minutes[name], units)
        for name in COMBINATIONS
        if len(drive.combinations.get(name, ()))
    ]


def _combination_row(
    name: str, end: np.ndarray, before: float, minutes: float, units: Units
) -> CombinationRow:
    label, form, learned_by = COMBINATIONS[name]
    _, value, std = end
    left = 100 * std / before if before > 0 else 100.0
    spread = f"± {100 * std / abs(value):.1f} %" if value else ""
    fast, slow = (
        f"{limit * units.speeds:.0f} {units.speed}" for limit in (FAST_SPEED, SLOW_SPEED)
    )
    learned_by = learned_by.format(fast=fast, slow=slow)
    text = f"{form.format(value)} {spread}"
    return CombinationRow(label, text, round(left), learned_by, f"{minutes:.1f}")
