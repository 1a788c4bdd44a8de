"""Plans from files of any kind, which their content shows."""

from __future__ import annotations

import json
from pathlib import Path
import zlib

import numpy as np

from evpinn_ros.bags.names import is_bag
from evpinn_ros.can.log_names import LOG_SUFFIXES
from evpinn_ros.common.errors import InputError, as_input_error, with_kind
from evpinn_ros.common.opener import open_unpacked
from evpinn_ros.core.energy.plan import MAX_POINTS, Legs, Plan, PlanError
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.logs.formats import TABLE_SUFFIXES, TEXT_SUFFIXES, suffix_of
from evpinn_ros.logs.plans.recorded import driven_plan, planned_in_bag
from evpinn_ros.logs.plans.route import legs_of_route
from evpinn_ros.logs.plans.table import COLUMNS, table_plan
from evpinn_ros.logs.plans.track import geojson_track, gpx_track, legs_of_track
from evpinn_ros.logs.read_options import READ_DEFAULTS, ReadOptions

MOST_XML = 32 << 20  # bytes, unpacked: 50,000 points with all that watches add
MOST_JSON = 16 << 20  # bytes
MOST_VALUES = 20 * MAX_POINTS  # of JSON; as an object of Python each takes up to 150 bytes
BLANK = b"\xef\xbb\xbf\xff\xfe\0 \t\r\n"  # before the first letter, marks of the encoding too
TEXTS = {*TEXT_SUFFIXES, ".json"}  # whose content says whether they are a plan or a drive
BINARY = {*LOG_SUFFIXES, *TABLE_SUFFIXES} - TEXTS  # and logs of other forms than tables
DAMAGED = (AttributeError, IndexError, OverflowError, RecursionError, TypeError, ValueError)
KNOWN = (
    "JSON of no known kind: known are GeoJSON and the answers of Valhalla, OSRM, GraphHopper and "
    "openrouteservice"
)


def read_plan(
    path: str | Path, vehicle: Vehicle | None = None, options: ReadOptions = READ_DEFAULTS
) -> Plan | Legs:
    """The plan (points or legs) in a file that docs/reference/inputs.md lists.

    InputError if it cannot be read, `PlanError` if it holds no trip; both name the file.
    """
    path = Path(path)
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused in words
            return _plan(path, vehicle or load_vehicle("generic"), options)
    except InputError as error:
        text = str(error)
        named = text if text.startswith(str(path)) else f"{path}: {text}"
        raise (PlanError if isinstance(error, PlanError) else InputError)(named) from error


def _plan(path: Path, vehicle: Vehicle, options: ReadOptions) -> Plan | Legs:
    if path.is_dir():
        return planned_in_bag(path, vehicle) or driven_plan(path, vehicle, options)
    if suffix_of(path) in BINARY and not is_bag(path):
        return driven_plan(path, vehicle, options)
    begin = _content(path, 64).lstrip(BLANK)[:1]
    if begin == b"{":
        return _json_plan(_whole(path, MOST_JSON))
    if begin == b"<":
        return legs_of_track(gpx_track(_whole(path, MOST_XML)))
    if is_bag(path):
        return planned_in_bag(path, vehicle) or driven_plan(path, vehicle, options)
    if (plan := table_plan(path)) is not None:
        return plan
    try:
        return driven_plan(path, vehicle, options)
    except PlanError:
        raise
    except InputError as error:
        reason = str(error).removeprefix(f"{path}: ").partition("; say --")[0]
        text = f"{path}: no plan, which has the {COLUMNS}; as a drive: {reason}"
        raise InputError(text) from error


def _content(path: Path, size: int) -> bytes:
    """The first bytes of a file, unpacked where it is gzipped; every plan's file opens here."""
    with as_input_error(path, EOFError, ValueError, zlib.error), open_unpacked(path) as file:
        return file.read(size)


def _whole(path: Path, most: int) -> bytes:
    content = _content(path, most + 1)
    if len(content) > most:
        raise PlanError(f"more than {most} bytes, which no plan needs")
    return content


def _json_plan(content: bytes) -> Legs:
    if sum(map(content.count, (b",", b"[", b"{"))) > MOST_VALUES:
        raise PlanError(f"more than {MOST_VALUES} values, which no plan needs")
    try:
        data = json.loads(content)
        if (legs := legs_of_route(data)) is not None:
            return legs
        if "type" not in data:
            raise PlanError(KNOWN)
        return legs_of_track(geojson_track(data))
    except KeyError as error:
        raise PlanError(f"its JSON lacks {error}") from error
    except DAMAGED as error:
        raise PlanError(f"its JSON is damaged: {with_kind(error)}") from error
