"""Reads the first route in an answer of a route service.

Formats by their documentation: Valhalla's `route` and `trace_attributes`
(valhalla.github.io/valhalla/api), OSRM (project-osrm.org/docs), GraphHopper (docs.graphhopper.com)
and openrouteservice (giscience.github.io/openrouteservice). The finest parts with a duration are
joined (`_lasting`) to legs: first those of one speed, as services split a road anywhere, then
until each lasts `SETTLED`, as the duration of a short part contains no stop.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
import math
from typing import Any, NamedTuple, TypeAlias
import warnings

import numpy as np

from evpinn_ros.core.energy.plan import MAX_POINTS, Legs, PlanError, refuse, sums
from evpinn_ros.core.estimation.even import runs_of
from evpinn_ros.logs.plans.way import Heights, legs_between, way_length

Json: TypeAlias = Mapping[str, Any]

METRES = {"m": 1.0, "km": 1000.0, "mi": 1609.344, "kilometers": 1000.0, "miles": 1609.344}
FOOT = 0.3048  # m
NO_HEIGHT = 32768.0  # marks an unknown elevation in Valhalla
SETTLED = 60.0  # s: shortest duration of a leg
OSRM_ROUTES = ("routes", "matchings", "trips")  # keys of its services route, match and trip
LONGEST = 16 * MAX_POINTS  # characters of an encoded line; a point takes four to twelve
# Carriers of the car: modes of OSRM, uses of Valhalla's edges, environments of GraphHopper.
CARRIERS = {"ferry", "train", "rail", "rail-ferry", "rail_ferry", "shuttle train", "shuttle_train"}
FERRY_MANEUVER, FERRY_SIGN = 28, 9  # types of Valhalla and GraphHopper
FERRY_CATEGORY, FERRY_WAY = 8, 9  # openrouteservice: a bit of `waycategory`, one of `waytypes`
LOST = 500.0  # m of a ferry that no part of a route shows
HIDDEN = "a part of it is partly on a ferry or a train; ask for finer parts"
# A part as long, m, and as slow, m/s, may be a ferry.
LONG_PART, SLOW_PART = 1000.0, 20.0 / 3.6
KNOWN = (
    "known are GeoJSON and the answers of Valhalla, OSRM, GraphHopper and openrouteservice, and "
    "drives that `evpinn replay` reads"
)
FOREIGN = f"an answer of an unknown route service (Google's is one): {KNOWN}"
MOST_CHUNKS = 7  # characters of a number: 35 bits, of which coordinates need 29


class RoutePart(NamedTuple):
    """A part of a route: length, m, duration, s, and whether the car is carried, as on a ferry."""

    length: float
    duration: float
    carried: bool = False


def legs_of_route(data: Json) -> Legs | None:
    """Legs of a route service's answer; None for other JSON, PlanError for an unusable answer."""
    if "legs" in (data.get("trip") or ()):
        return _valhalla_route(_first([data["trip"], *(data.get("alternates") or ())]))
    if "edges" in data:
        return _valhalla_edges(data)
    if data.get("paths"):
        return _graphhopper(_first(data["paths"]))
    if data.get("features") and "segments" in (data["features"][0].get("properties") or {}):
        feature = _first(data["features"])
        return _openrouteservice(feature["properties"], feature["geometry"], data)
    if kind := next((name for name in OSRM_ROUTES if data.get(name)), None):
        return _routes(kind, data)
    if reason := data.get("error") or data.get("message") or data.get("code"):
        named = isinstance(reason, Mapping)
        text = (reason.get("message") or reason.get("description")) if named else reason
        if text == "Ok":  # of another service, such as OSRM's table
            raise PlanError("there is no route in this answer")
        raise PlanError(f"the route service found no route: {text}")
    return None


def _first(routes: Sequence[Json]) -> Json:
    """The first of alternatives; warns of the others."""
    if len(routes) > 1:
        warnings.warn(f"the first of {len(routes)} routes is taken", stacklevel=4)
    return routes[0]


def _routes(kind: str, data: Json) -> Legs:
    """The first of `routes`, of OSRM or openrouteservice, or all of OSRM's other `OSRM_ROUTES`."""
    routes = data[kind]
    if not isinstance(routes, list):
        raise PlanError(FOREIGN)
    if kind == "routes":
        routes = [_first(routes)]
    elif len(routes) > 1:  # where a trace or the network is interrupted
        text = f"{len(routes)} {kind} follow each other; the ways between them are unknown"
        warnings.warn(f"{text} and left out", stacklevel=4)
    if "segments" in routes[0]:
        return _openrouteservice(routes[0], routes[0].get("geometry"), data)
    legs = [leg for route in routes for leg in route.get("legs") or [{}]]
    if not all(isinstance(leg.get("distance"), int | float) for leg in legs):
        raise PlanError(FOREIGN)
    parts = [part for leg in legs for part in _osrm_parts(leg)]
    return _legs(parts, told=all(leg.get("steps") for leg in legs))


def _legs(
    parts: Sequence[RoutePart], heights: Heights | None = None, *, told: bool = True
) -> Legs:
    """Legs of the parts that are driven; warns of a possible ferry unless these are `told`."""
    if not parts:
        raise PlanError("its route has no legs or steps")
    rows = np.array(parts, float)
    refuse(~np.isfinite(rows).all(axis=1), "length or time is unknown, or speed 0", "part")
    if not told:
        _warn_of_ferry(rows)
    if (carried := rows[:, 2] > 0).any():
        rows, heights = _driven(rows, carried, heights)
    length, duration = _lasting(rows[:, :2]).T
    if heights is not None and np.isfinite(heights.height).any():  # once per `SETTLED`
        pieces = np.maximum(duration // SETTLED, 1).astype(int)
        length, duration = (np.repeat(column / pieces, pieces) for column in (length, duration))
    return legs_between(sums(duration), sums(length), heights)


def _warn_of_ferry(rows: np.ndarray) -> None:
    slow = rows[(rows[:, 0] < SLOW_PART * rows[:, 1]) & (rows[:, 2] == 0)]
    metres, seconds, _ = max(slow.tolist(), default=(0.0, 0.0, 0.0))
    if metres > LONG_PART:
        warnings.warn(
            f"a part of {metres / 1e3:.1f} km takes {seconds / 60:.0f} min and counts as driven: "
            "this answer does not say where ferries are",
            stacklevel=5,
        )


def _driven(
    rows: np.ndarray, carried: np.ndarray, heights: Heights | None
) -> tuple[np.ndarray, Heights | None]:
    """Parts that the car drives, and the heights along them; warns of omitted parts."""
    metres, seconds, _ = rows[carried].sum(0)
    warnings.warn(
        f"{metres / 1e3:.1f} km and {seconds / 60:.0f} min on a ferry or a train are left out",
        stacklevel=4,
    )
    if carried.all():
        raise PlanError("its whole route is on a ferry or a train")
    if heights is not None:
        ends, driven = sums(rows[:, 0]), sums(np.where(carried, 0.0, rows[:, 0]))
        part = np.clip(np.searchsorted(ends, heights.along, "right") - 1, 0, len(rows) - 1)
        ashore = ~carried[part]
        along = np.interp(heights.along, ends, driven)
        heights = Heights(along[ashore], heights.height[ashore])
    return rows[~carried], heights


def _carried(
    spans: Sequence[Sequence[int]], carriers: Sequence[Sequence[int]], along: np.ndarray
) -> list[bool]:
    """True for each span of points on most of which the car is carried.

    `along` are distances of the points, m; PlanError if a span hides a ferry.
    """

    def shared(span: Sequence[int]) -> float:
        ends = ((max(span[0], begin), min(span[1], end)) for begin, end, *_ in carriers)
        return sum(float(along[end] - along[begin]) for begin, end in ends if begin < end)

    lengths = [float(along[span[1]] - along[span[0]]) for span in spans]
    is_carried = [shared(span) > 0.5 * length for span, length in zip(spans, lengths, strict=True)]
    counted = sum(length for length, carried in zip(lengths, is_carried, strict=True) if carried)
    if abs(sum(float(along[end] - along[begin]) for begin, end, *_ in carriers) - counted) > LOST:
        raise PlanError(HIDDEN)
    return is_carried


def _lasting(parts: np.ndarray) -> np.ndarray:
    """Lengths, m, and durations, s, (n, 2), joined if of one speed and until `SETTLED`."""
    begins_one = np.concatenate(([True], parts[:-1, 1] > 0.0))  # others join the next part
    parts = np.add.reduceat(parts, np.flatnonzero(begins_one))
    with np.errstate(divide="ignore", invalid="ignore"):
        run = runs_of(parts[:, 1], parts[:, 0])
    parts = np.add.reduceat(parts, np.flatnonzero(np.diff(run, prepend=-1)))
    begins, lasted = [0], 0.0
    for index, seconds in enumerate(parts[:, 1].tolist()):
        if lasted >= SETTLED:
            begins.append(index)
            lasted = 0.0
        lasted += seconds
    if lasted < SETTLED and len(begins) > 1:
        del begins[-1]
    return np.asarray(np.add.reduceat(parts, begins))


def _scaled(parts: Sequence[float] | np.ndarray, total: float) -> np.ndarray:
    """The parts, scaled so that they add up to `total`; unchanged if either is 0."""
    numbers = np.array(parts, float)
    return numbers * (total / numbers.sum()) if total > 0 and numbers.sum() > 0 else numbers


def _valhalla_route(trip: Json) -> Legs:
    metres, metres_up = _units(trip)
    parts: list[RoutePart] = []
    heights: list[np.ndarray] = []
    end = 0.0
    for leg in trip["legs"]:
        maneuvers = leg.get("maneuvers") or [leg["summary"]]
        parts += [
            RoutePart(
                maneuver["length"] * metres,
                maneuver["time"],
                bool(maneuver.get("ferry")) or maneuver.get("type") == FERRY_MANEUVER,
            )
            for maneuver in maneuvers
        ]
        ferry = (leg.get("summary") or {}).get("has_ferry")
        if ferry and not any(part.carried for part in parts[-len(maneuvers) :]):
            raise PlanError(HIDDEN)
        begin, end = end, end + sum(maneuver["length"] for maneuver in maneuvers) * metres
        if leg.get("elevation"):
            up = np.array(leg["elevation"], float) * metres_up
            along = begin + np.arange(len(up)) * float(leg["elevation_interval"]) * metres_up
            heights.append(np.array([np.minimum(along, end), up]))
    return _legs(parts, Heights(*np.hstack(heights)) if heights else None)


def _valhalla_edges(data: Json) -> Legs:
    """The edges of `trace_attributes`, by the time of the path at their ends."""
    edges = data["edges"]
    metres, metres_up = _units(data)
    length = np.array([edge["length"] for edge in edges], float) * metres
    ends = [(edge.get("end_node") or {}).get("elapsed_time") for edge in edges]
    if None in ends:
        duration = length / (np.array([edge["speed"] for edge in edges], float) * metres / 3600)
    else:
        duration = np.diff(np.array(ends, float), prepend=0.0)
    middle = np.array([edge.get("mean_elevation", NO_HEIGHT) for edge in edges], float)
    height = np.where(middle == NO_HEIGHT, np.nan, middle * metres_up)
    carried = [edge.get("use") in CARRIERS for edge in edges]
    parts = [*map(RoutePart, length, duration, carried)]
    heights = Heights(np.cumsum(length) - length / 2, height)
    return _legs(parts, heights, told=all("use" in edge for edge in edges))


def _units(answer: Json) -> tuple[float, float]:
    """Metres per unit of length, and of height, in an answer of Valhalla."""
    units = answer.get("units", "kilometers")
    return METRES[units], FOOT if units == "miles" else 1.0


def _osrm_parts(leg: Json) -> Iterator[RoutePart]:
    """Segments of the annotation, scaled to the leg's duration, which includes turns; or steps."""
    given = leg.get("annotation") or {}
    steps = [
        RoutePart(step["distance"], step["duration"], step.get("mode") in CARRIERS)
        for step in leg.get("steps") or [leg]
    ]
    if "distance" in given and ("duration" in given or "speed" in given):
        length = np.array(given["distance"], float)
        if "duration" in given:
            duration = np.array(given["duration"], float)
        else:
            duration = length / np.array(given["speed"], float)
        if not any(step.carried for step in steps):
            yield from map(RoutePart, length, _scaled(duration, float(leg["duration"])))
            return
        rows = np.array(steps, float)
        ends = np.cumsum(_scaled(length, rows[:, 0].sum()))
        step = np.searchsorted(np.cumsum(rows[:, 0]), ends - np.diff(ends, prepend=0.0) / 2)
        for number in np.unique(step):
            scaled = _scaled(duration[step == number], rows[number, 1])
            for metres, seconds in zip(length[step == number], scaled, strict=True):
                yield RoutePart(metres, seconds, steps[number].carried)
    else:
        yield from steps


def _graphhopper(path: Json) -> Legs:
    """Intervals of `details`, which end at points of the line; else instructions."""
    total, details = float(path["distance"]), path.get("details") or {}
    line = _line(path.get("points"), total, path.get("points_encoded_multiplier", 1e5))
    timed = next((name for name in ("time", "average_speed") if name in details), "")
    instructions = path.get("instructions") or [path]
    environment = details.get("road_environment") or ()
    carriers = [span for span in environment if span[2] in CARRIERS]
    carriers = carriers or [
        part["interval"] for part in instructions if part.get("sign") == FERRY_SIGN
    ]
    if line:
        line = line._replace(along=_as_instructed(line.along, instructions))
    if line and timed:
        rows = [(line.along[end] - line.along[begin], value)
                for begin, end, value in details[timed]]  # fmt: skip
        spans = details[timed]
    else:
        rows = [(instruction["distance"], instruction["time"]) for instruction in instructions]
        spans = [instruction.get("interval", (0, -1)) for instruction in instructions]
    along = line.along if line else np.arange(1 + max((span[1] for span in spans), default=0))
    carried = _carried(spans, carriers, along) if carriers else [False] * len(rows)
    lengths, values = np.array(rows, float).T
    by_speed = line and timed == "average_speed"
    seconds = _scaled(lengths / values if by_speed else values, path["time"] / 1000)
    told = "road_environment" in details or "instructions" in path
    return _legs([*map(RoutePart, lengths, seconds, carried)], line, told=told)


def _as_instructed(along: np.ndarray, instructions: Sequence[Json]) -> np.ndarray:
    """Distances of a line's points, m, scaled to the lengths of the instructions."""
    steps = np.diff(along)
    for begin, end, length in (
        (*instruction["interval"], instruction["distance"])
        for instruction in instructions
        if "interval" in instruction
    ):
        steps[begin:end] = _scaled(steps[begin:end], float(length))
    return sums(steps)


def _openrouteservice(route: Json, geometry: Any, data: Json) -> Legs:
    """The steps of the segments; the segments if the answer has no instructions."""
    query = (data.get("metadata") or {}).get("query") or {}
    metres = METRES[query.get("units", "m")]
    parts: list[RoutePart] = []
    spans: list[Sequence[int]] = []
    for segment in route["segments"]:
        steps = segment.get("steps") or [segment]
        lengths = _scaled([step["distance"] for step in steps], segment["distance"] * metres)
        parts += map(RoutePart, lengths, [step["duration"] for step in steps])
        spans += (step.get("way_points", (0, 0)) for step in steps)
    line = _line(geometry, sum(part.length for part in parts), 1e5)
    extras = route.get("extras") or {}
    if "waycategory" in extras:
        values = extras["waycategory"]["values"]
        carriers = [span for span in values if int(span[2]) & FERRY_CATEGORY]
    else:
        values = extras.get("waytypes", {}).get("values", ())
        carriers = [span for span in values if span[2] == FERRY_WAY]
    if carriers and line:
        carried = _carried(spans, carriers, line.along)
        parts = [part._replace(carried=are) for part, are in zip(parts, carried, strict=True)]
    return _legs(parts, line, told="waycategory" in extras or "waytypes" in extras)


def _line(line: Any, total: float, scale: float) -> Heights | None:
    """Points of a line scaled to `total`, m; with heights if its length then fits better."""
    if not line:
        return None
    if isinstance(line, str):
        lines = [*_decoded(line, scale)]
        if not lines:
            raise PlanError("its polyline is damaged")
        places = min(lines, key=lambda line: abs(line[0][-1] - total))
    else:
        rows = np.array([[*point[:3], math.nan][:3] for point in line["coordinates"]], float)
        places = way_length(rows[:, 0], rows[:, 1]), rows[:, 2]
    along, height = places
    return Heights(sums(_scaled(np.diff(along), total)), height)


def _decoded(line: str, scale: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Distances along an encoded line and heights, m, decoded without and with heights."""
    for dimensions in (2, 3):
        with suppress(PlanError):
            latitude, longitude, *height = decode_polyline(line, scale, dimensions).T
            along = way_length(longitude, latitude)
            yield along, height[0] if height else np.full(len(along), math.nan)


def decode_polyline(text: str, scale: float, dimensions: int) -> np.ndarray:
    """Latitude, longitude and perhaps height (0.01 m) of Google's polyline, shape (n, dimensions).

    `scale`: units per degree, 1e5 or 1e6. PlanError: the text is damaged.
    """
    if len(text) > LONGEST:
        raise PlanError(f"a polyline of more than {LONGEST} characters")
    codes = np.frombuffer(text.encode("latin-1", "replace"), np.uint8).astype(np.int64) - 63
    ends = np.flatnonzero(codes < 32)
    starts = np.concatenate(([0], ends[:-1] + 1))
    lengths = ends - starts + 1
    valid = len(ends) > 0 and len(ends) % dimensions == 0 and ends[-1] == len(codes) - 1
    if not valid or codes.min() < 0 or codes.max() > 63 or lengths.max() > MOST_CHUNKS:
        raise PlanError("its polyline is damaged")
    shifts = 5 * (np.arange(len(codes)) - np.repeat(starts, lengths))
    numbers = np.add.reduceat((codes & 31) << shifts, starts)
    steps = np.where(numbers & 1, ~(numbers >> 1), numbers >> 1)
    places = steps.reshape(-1, dimensions).cumsum(axis=0)
    scaled: np.ndarray = places / np.array([scale, scale, 100.0])[:dimensions]
    return scaled
