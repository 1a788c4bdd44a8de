"""`evpinn info`: shows what a recording contains, and which part the estimator can use."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from itertools import chain
import math
from pathlib import Path
from typing import Annotated, Any

import typer

from evpinn_ros.cli.console import moment, note, progress_bar, say, show, write_json
from evpinn_ros.cli.options import (
    CanProfileOption,
    CarOption,
    ColumnOption,
    JsonOption,
    UnitsOption,
)
from evpinn_ros.cli.table_columns import choice, shorter
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.common.units import Units, UnitSystem
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.logs.column import by_reason
from evpinn_ros.logs.contents import Contents, contents
from evpinn_ros.logs.data_coverage import DataCoverage, ReadingFlow, Span
from evpinn_ros.logs.formats import files_of
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.replays.history import FIRST_STAMP_NS
from evpinn_ros.report.dropped_text import dropped_text

MOST_SPANS = 10  # on the terminal; --json has them all


def info(
    inputs: Annotated[
        list[Path], typer.Argument(help="Bags, CAN logs, tables, or a folder of them.")
    ],
    column: ColumnOption = None,
    car: CarOption = None,
    can_profile: CanProfileOption = None,
    json_file: JsonOption = None,
    units: UnitsOption = UnitSystem.METRIC,
) -> None:
    """Show what recordings contain, and which part of them the estimator can use.

    Example: evpinn info bags/urban drive.log drive.csv
    """
    recordings: list[Contents] = []
    options = ReadOptions(can_profile, columns=column or (), car=car)
    problems = 0
    for path in chain.from_iterable(map(files_of, inputs)):
        try:
            recordings.append(contents(path, options, partial(progress_bar, path.name)))
        except InputError as error:
            problems += 1
            note(f"evpinn: {error}")
            continue
        _show(recordings[-1], units.units)
    if json_file is not None:
        write_json(json_file, [_as_json(recording) for recording in recordings])
    if problems:
        raise typer.Exit(1)


def _show(recording: Contents, units: Units) -> None:
    if recording.topics:
        columns = ("topic", "type", "messages", "Hz", "longest gap")
        rows = [(topic.name, topic.type_name, *_flow(topic.flow)) for topic in recording.topics]
        show(PlainTable(f"{recording.path}", columns, rows, words=("type",)))
    for line in _lines(recording, units):
        say(line)


def _lines(recording: Contents, units: Units) -> Iterator[str]:
    begin, end = recording.span_ns or (0, 0)
    when = f"{(end - begin) / NANOSECONDS:.1f} s{_start(recording, begin)}" if end else "empty"
    yield f"{recording.path}: {recording.kind}, {when}"
    for column in recording.columns:
        yield f"  {column.quantity}: column {choice(column)} ({column.basis})"
    for why, names in by_reason(recording.unused).items():
        yield f"  not used, {why}: {shorter(names)}"
    if recording.frames:
        fits = f"read by {recording.profile}" if recording.profile else "no known profile fits"
        yield f"  CAN frames: {fits}"
    if recording.vehicles:
        yield f"  use: --vehicle {' or '.join(recording.vehicles)}"
    elif recording.profile:
        yield f"  use: --can-profile {recording.profile}"
    if recording.drive is not None:
        yield from _drive_lines(recording.drive, begin, units)
    if lost := dropped_text(recording.dropped or {}):
        yield f"  lost: {lost}"
    for text in recording.notes:
        yield f"  {text}"


def _start(recording: Contents, begin_ns: int) -> str:
    """Start of a recording as text, which says if its date or time zone is unknown."""
    if recording.dated == "" or begin_ns < FIRST_STAMP_NS:
        return ", without a date"
    day = ", the day taken from the file's name" if recording.dated == "name" else ""
    zone = " UTC" if recording.zoned else ", local time"
    return f" from {moment(begin_ns)}{zone}{day}"


def _drive_lines(drive: DataCoverage, begin_ns: int, units: Units) -> Iterator[str]:
    for kind, flow in drive.flows.items():
        yield f"  {kind}: {flow.count} readings, {_pace(flow)}longest gap {flow.longest_gap:.2f} s"
    voltage = "" if math.isnan(drive.voltage) else f"; mean voltage {drive.voltage:.0f} V"
    first, last = drive.charge
    charge = "" if math.isnan(first) else f"; state of charge {first:.1%} to {last:.1%}"
    yield f"  distance: {drive.distance / units.metres:.2f} {units.distance}{voltage}{charge}"
    yield f"  estimator: {drive.verdict}"
    for first, last in _relative(drive.spans[:MOST_SPANS], _origin(drive, begin_ns)):
        yield f"    {first:.1f} s to {last:.1f} s"
    if len(drive.spans) > MOST_SPANS:
        yield f"    and {len(drive.spans) - MOST_SPANS} more"


def _origin(drive: DataCoverage, begin_ns: int) -> int:
    """Stamp of 0 s: the start of the recording, or of its readings if their clock is behind."""
    starts = [first for flow in drive.flows.values() for first, _ in flow.runs]
    return min(starts) if starts and min(starts) < begin_ns else begin_ns


def _relative(spans: tuple[Span, ...], begin_ns: int) -> Iterator[tuple[float, float]]:
    for first, last in spans:
        yield (first - begin_ns) / NANOSECONDS, (last - begin_ns) / NANOSECONDS


def _pace(flow: ReadingFlow) -> str:
    """Rate between the gaps, as "5.0 a second, " or "one every 2.0 s, "; empty if unknown."""
    apart = sum(last - first for first, last in flow.runs) / NANOSECONDS
    rate = (flow.count - len(flow.runs)) / apart if apart > 0.0 else flow.rate
    if not rate > 0.0:
        return ""
    return f"{rate:.1f} a second, " if rate >= 1.0 else f"one every {1.0 / rate:.1f} s, "


def _flow(flow: ReadingFlow) -> tuple[str, str, str]:
    if not flow.count:
        return "0", "", ""
    rate = f"{flow.rate:.1f}" if math.isfinite(flow.rate) else ""
    return str(flow.count), rate, f"{flow.longest_gap:.2f} s"


def _as_json(recording: Contents) -> dict[str, Any]:
    begin, end = recording.span_ns or (0, 0)
    drive = recording.drive
    return {
        "path": str(recording.path),
        "kind": recording.kind,
        "start_ns": begin if recording.dated != "" else None,
        "duration_s": (end - begin) / NANOSECONDS,
        "topics": [
            {"name": topic.name, "type": topic.type_name, **_flow_json(topic.flow)}
            for topic in recording.topics
        ],
        "columns": [asdict(column) | {"basis": column.basis} for column in recording.columns],
        "columns_not_used": list(recording.unused),
        "columns_not_used_why": by_reason(recording.unused),
        "can_profile": recording.profile,
        "vehicles": list(recording.vehicles),
        "readings": {k: _flow_json(flow) for k, flow in (drive.flows if drive else {}).items()},
        "distance_m": drive.distance if drive else None,
        "voltage_v": drive.voltage if drive else None,
        "usable": None
        if drive is None
        else {
            "verdict": drive.verdict,
            "seconds": drive.seconds,
            "moving_s": drive.moving,
            "spans_s": list(_relative(drive.spans, _origin(drive, begin))),
        },
        "dropped": dict(recording.dropped or {}),
        "notes": list(recording.notes),
    }


def _flow_json(flow: ReadingFlow) -> dict[str, Any]:
    gaps = {"longest_gap_s": flow.longest_gap, "gaps": flow.gaps}
    return {"count": flow.count, "rate_hz": flow.rate, **gaps}
