"""Reads plans from files; their content decides the format."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
import json
import math
from pathlib import Path
import warnings
import zlib

import numpy as np

from evpinn_ros.bags.names import is_bag
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import decode
from evpinn_ros.can.log_names import LOG_SUFFIXES
from evpinn_ros.common.errors import InputError, as_input_error, with_kind
from evpinn_ros.common.opener import open_unpacked
from evpinn_ros.core.energy.driven import PLAN_STEP, drive_plan
from evpinn_ros.core.energy.path_plan import NOMINAL_SPEED
from evpinn_ros.core.energy.plan import (
    MAX_POINTS,
    Legs,
    Plan,
    PlanError,
    points_of,
    sums,
    travelled,
)
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    GradeReading,
    Reading,
    SpeedReading,
)
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.logs.formats import TABLE_SUFFIXES, TEXT_SUFFIXES, suffix_of
from evpinn_ros.logs.plans.route import KNOWN, legs_of_route
from evpinn_ros.logs.plans.table import COLUMNS, table_plan, warn_of_unused
from evpinn_ros.logs.plans.track import GeoTrack, geojson_track, gpx_track, legs_of_track
from evpinn_ros.logs.plans.way import plausible_heights
from evpinn_ros.logs.read_options import READ_DEFAULTS, ReadOptions
from evpinn_ros.logs.rows_to_blocks import BATTERY
from evpinn_ros.logs.source import Source
from evpinn_ros.logs.sources import open_source
from evpinn_ros.topics import FRAME_TYPE, SPEEDS
from evpinn_ros.topics.plans import PLAN_TYPES, plan_of_message

FASTEST_MEAN = 45.0  # m/s on the whole of a trip
MOST_XML = 32 << 20  # bytes, unpacked: 50,000 points with the data that watches add
MOST_JSON = 16 << 20  # bytes
MOST_VALUES = 20 * MAX_POINTS  # values of JSON; each takes up to 150 bytes as a Python object
BLANK = b"\xef\xbb\xbf\xff\xfe\0 \t\r\n"  # bytes before the first letter, and byte order marks
TEXTS = {*TEXT_SUFFIXES, ".json"}  # suffixes of plans or drives; the content decides
BINARY = {*LOG_SUFFIXES, *TABLE_SUFFIXES} - TEXTS  # suffixes of drives only, also CAN logs
DAMAGED = (AttributeError, IndexError, OverflowError, RecursionError, TypeError, ValueError)


def read_plan(
    path: str | Path, vehicle: Vehicle | None = None, options: ReadOptions = READ_DEFAULTS
) -> Plan | Legs:
    """The plan in a file, as points or legs; docs/reference/inputs.md lists the formats.

    InputError if it cannot be read, `PlanError` if it contains no trip; both name the file.
    """
    path = Path(path)
    try:
        with np.errstate(all="ignore"):  # non-finite values are refused later, in words
            plan = _plan(path, vehicle or load_vehicle("generic"), options)
    except InputError as error:
        text = str(error)
        named = text if text.startswith(str(path)) else f"{path}: {text}"
        raise (PlanError if isinstance(error, PlanError) else InputError)(named) from error
    if options.pace is not None and not _is_driven_at(options.pace, plan):
        warnings.warn("the speed that was given is not used: this plan has its own", stacklevel=2)
    warn_if_fast(plan)
    return plan


def warn_if_fast(plan: Plan | Legs) -> None:
    """Warn of a mean speed that hardly any trip has: its speeds may be in km/h."""
    points = points_of(plan)
    mean = float(np.ptp(points.distance) / np.ptp(points.time))
    if mean > FASTEST_MEAN:
        warnings.warn(
            f"it drives {3.6 * mean:.0f} km/h ({mean:.0f} m/s) on the whole; are its units right?",
            stacklevel=3,
        )


def _is_driven_at(pace: float, plan: Plan | Legs) -> bool:
    return isinstance(plan, Legs) and np.allclose(plan.length, pace * plan.duration)


def _plan(path: Path, vehicle: Vehicle, options: ReadOptions) -> Plan | Legs:
    if path.is_dir():
        return planned_in_bag(path, vehicle) or driven_plan(path, vehicle, options)
    if suffix_of(path) in BINARY and not is_bag(path):
        return driven_plan(path, vehicle, options)
    begin = _content(path, 64).lstrip(BLANK)[:1]
    is_json = suffix_of(path) == ".json"
    if begin == b"{" or (begin == b"[" and is_json):
        try:
            return _json_plan(_whole(path, MOST_JSON), options)
        except PlanError:
            if is_json:
                with suppress(InputError):
                    return driven_plan(path, vehicle, options)
            raise
    if begin == b"<":
        return _track_plan(gpx_track(_whole(path, MOST_XML)), options)
    if is_bag(path):
        return planned_in_bag(path, vehicle) or driven_plan(path, vehicle, options)
    if not options.columns and (plan := table_plan(path)) is not None:
        _warn_of_terrain(options)
        return plan
    try:
        return driven_plan(path, vehicle, options)
    except PlanError:
        raise
    except InputError as error:
        reason = str(error).removeprefix(f"{path}: ").partition("; say --")[0]
        text = f"{path}: neither a plan, with the {COLUMNS}, nor a drive: {reason}"
        raise InputError(text) from error


def _content(path: Path, size: int) -> bytes:
    """The first bytes of a file, decompressed if gzipped; every plan file is opened here."""
    with as_input_error(path, EOFError, ValueError, zlib.error), open_unpacked(path) as file:
        return file.read(size)


def _whole(path: Path, most: int) -> bytes:
    content = _content(path, most + 1)
    if len(content) > most:
        raise PlanError(f"more than {most} bytes, which no plan needs")
    return content


def _track_plan(track: GeoTrack, options: ReadOptions) -> Legs:
    """The legs of a track, with heights of the ground where tiles have any."""
    if options.terrain is not None:
        longitude, latitude, height = track.place.T
        ground = options.terrain.heights(latitude, longitude)
        height = np.where(np.isnan(ground), height, ground)
        track = track._replace(place=np.column_stack((longitude, latitude, height)))
    return legs_of_track(track, options.pace)


def _warn_of_terrain(options: ReadOptions) -> None:
    if options.terrain is not None:
        text = "tiles of elevation are not used: of this kind of plan no positions are read"
        warnings.warn(text, stacklevel=4)


def _json_plan(content: bytes, options: ReadOptions) -> Legs:
    if sum(map(content.count, (b",", b"[", b"{"))) > MOST_VALUES:
        raise PlanError(f"more than {MOST_VALUES} values, which no plan needs")
    try:
        data = json.loads(content)
        if not isinstance(data, dict):
            raise PlanError(f"JSON of no known kind: {KNOWN}")
        if (legs := legs_of_route(data)) is not None:
            _warn_of_terrain(options)
            return legs
        if "type" not in data:
            raise PlanError(f"unknown JSON: {KNOWN}")
        return _track_plan(geojson_track(data), options)
    except KeyError as error:
        raise PlanError(f"its JSON lacks {error}") from error
    except json.JSONDecodeError as error:
        raise PlanError(f"its JSON is damaged: {error}") from error
    except DAMAGED as error:
        raise PlanError(f"its JSON is damaged: {with_kind(error)}") from error


FIELDS = {SpeedReading: "speed", AltitudeReading: "altitude", GradeReading: "grade"}
ROAD = {"time", "speed", "elevation", "grade", "latitude", "longitude"}  # columns of a plan
LEAST_GAP = 60.0  # s between two speeds
GAP_STEPS = 10.0  # mean steps, which a gap also exceeds: some plans have few rows
LONG_GAP = 600.0  # s; after a longer gap another drive begins
STANDING = 0.5  # m/s, highest speed before and after a gap of a standing car
SHORTEST = 2.0  # s
UNIT_OF_TIME = "name the column of times with its unit, as t_s or 'time [ms]'"
AS_DRIVEN = "; it is taken as driven; --expected adds what drivers do between its points"
DRIVEN = {topic.type_name for topic in SPEEDS} | {FRAME_TYPE}


def driven_plan(path: Path, vehicle: Vehicle, options: ReadOptions) -> Plan:
    """A recorded drive of any kind as a plan; InputError if unreadable, PlanError if invalid."""
    source = open_source(path, vehicle, replace(options, battery=False))
    readings = [reading for reading in source.readings() if type(reading) in FIELDS]
    if source.problem:
        raise InputError(source.problem)
    mixed = not source.in_order and not source.dated  # rows may be legs with durations
    if mixed or source.dropped["time_not_increasing"] > len(readings):
        raise PlanError("its times do not rise; is the column of times the right one?")
    recorded = not source.rules or source.dated or any(r.quantity in BATTERY for r in source.rules)
    plan = plan_of_readings(readings, recorded=bool(recorded))
    _warn_of_choices(source, AS_DRIVEN if plan.commanded else "")
    return plan


def _warn_of_choices(source: Source, taken: str) -> None:
    """Warn of the columns of a table that were chosen by name and values, and how it is taken."""
    if any(rule.why for rule in source.rules):
        chosen = "; ".join(
            f"{rule.quantity} {rule.name!r}{f', {rule.unit}' * bool(rule.unit)} ({rule.basis})"
            for rule in source.rules
            if rule.quantity in ROAD
        )
        warnings.warn(f"read as a drive by the columns {chosen}{taken}", stacklevel=2)
    for assumed in source.assumptions:
        if assumed.partition(":")[0] in ROAD:
            warnings.warn(assumed, stacklevel=2)
    others = (rule.name for rule in source.rules if rule.quantity not in {*ROAD, *BATTERY})
    warn_of_unused((*source.ignored, *others))


def plan_of_readings(readings: Iterable[Reading], *, recorded: bool = True) -> Plan:
    """The plan of a drive's speeds and altitudes, or else grades, without pauses of the log.

    Unless `recorded`, the speeds have no gaps and the heights are exact.
    """
    rows: dict[type, list[tuple[int, float]]] = {kind: [] for kind in FIELDS}
    for reading in readings:
        if (kind := type(reading)) in FIELDS:
            rows[kind].append((reading.stamp_ns, getattr(reading, FIELDS[kind])))
    start = min((stamp for stamp, _ in rows[SpeedReading]), default=0)
    speed, altitude, grade = (_series(rows[kind], start) for kind in FIELDS)
    if len(speed) < 2 or speed[-1, 0] < SHORTEST:
        raise PlanError(f"a drive of less than {SHORTEST:g} s is no plan; {UNIT_OF_TIME}")
    time = _driven(speed) if recorded else speed[:, 0]
    for series in (altitude, grade, speed):
        series[:, 0] = np.interp(series[:, 0], speed[:, 0], time)
    if len(altitude) and (np.ptp(altitude[:, 1]) or not len(grade)):
        along = np.interp(altitude[:, 0], time, travelled(time, speed[:, 1]))
        altitude[:, 1] = plausible_heights(along, altitude[:, 1])
    elif len(grade):
        slope = np.sin(np.interp(time, *grade.T))
        altitude = np.column_stack((time, travelled(time, speed[:, 1] * slope)))
    plan = replace(drive_plan(speed, altitude), level=len(grade) > 0)
    if recorded or plan.commanded or not len(altitude):
        return plan
    return replace(plan, elevation=np.interp(plan.time, *altitude.T))  # exact, not a receiver's


def _series(rows: list[tuple[int, float]], start: int) -> np.ndarray:
    value_at = dict(sorted(row for row in rows if np.isfinite(row[1])))
    seconds = [((stamp - start) / NANOSECONDS, value) for stamp, value in value_at.items()]
    return np.array(seconds, float).reshape(-1, 2)


def _driven(speed: np.ndarray) -> np.ndarray:
    """Times since the first speed, s; long gaps, except of standing, are cut to `PLAN_STEP`."""
    steps = np.diff(speed[:, 0])
    gap = steps > max(LEAST_GAP, GAP_STEPS * float(np.minimum(steps, LONG_GAP).mean()))
    moving = np.maximum(np.abs(speed[:-1, 1]), np.abs(speed[1:, 1])) > STANDING
    left_out = gap & (moving | (steps > LONG_GAP))
    return sums(np.where(left_out, PLAN_STEP, steps))


def planned_in_bag(path: Path, vehicle: Vehicle) -> Plan | None:
    """The newest plan in a bag, as the node reads it; None if it has none, or is a drive."""
    nominal = vehicle.nominal_speed
    usual = NOMINAL_SPEED if math.isnan(nominal) else nominal
    plan: Plan | PlanError | None = None
    with BagReader(path) as bag:
        if DRIVEN & {topic.type_name for topic in bag.topics.values()}:
            return None
        names = {name for name, topic in bag.topics.items() if topic.type_name in PLAN_TYPES}
        for record in bag.raw_records(names):
            try:
                plan = plan_of_message(record.type_name, record.message, decode, usual)
            except PlanError as error:
                plan = plan or PlanError(f"{record.topic}: {error}")
    if isinstance(plan, PlanError):
        raise plan
    return plan
