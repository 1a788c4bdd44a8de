"""Tracks and routes: GPX 1.0 and 1.1, and lines of GeoJSON (RFC 7946).

GPX has `time` in UTC and `speed`, m/s, as a child or in Garmin's TrackPointExtension v2. GeoJSON
has no standard for times: `coordTimes` (tyrasd/togpx) or `times`, also in `coordinateProperties`,
as ISO 8601, s, or ms since 1970, and `speeds`, m/s.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple
import warnings
from xml.etree.ElementTree import ParseError, XMLParser

import numpy as np

from evpinn_ros.common.optional import optional_imports
from evpinn_ros.core.energy.driven import is_trace
from evpinn_ros.core.energy.plan import MAX_POINTS, Legs, PlanError, refuse, sums
from evpinn_ros.logs.plans.way import (
    Heights,
    legs_between,
    way_length,
    with_borders,
    without_noise,
    without_wander,
)

with optional_imports():
    import polars as pl

MILLISECONDS_FROM = 1e11  # as seconds since 1970 it would be the year 5138
TIMES, SPEEDS = ("coordTimes", "times"), ("speeds",)
PARTS = ("trkseg", "rte")
POINTS, DETAILS = ("trkpt", "rtept"), ("ele", "time", "speed")
SHAPE = "rpt"  # a point of the road between two points of a route, in Garmin's extension
MOST_PLACES = 2 * MAX_POINTS  # of a GPX file; each takes some 500 bytes, and some have no time
PIECE = 1 << 16  # bytes
LEAST_GAP = 60.0  # s between two segments, as for a recorded drive; less is lost reception
FAR = 1000.0  # m between points, beyond which the road may well bend
MEETING = 100.0  # m between the ends of two lines that meet
ALIKE = 1e-3  # degrees, some 100 m, between ends that are the same
DEEPEST = 100  # nested elements: the parser keeps every open one
NEITHER = (
    "its points have neither speeds nor times that differ: say --speed 90km/h (speed_kmh=90), "
    "export it with times, or give the route as the JSON of its service or as a table of legs"
)


class GeoTrack(NamedTuple):
    """Points of a track; NaN where unknown."""

    place: np.ndarray  # shape (n, 3), longitude and latitude, degrees, and height, m
    time: np.ndarray  # shape (n,), s since any start, NaN where unknown
    speed: np.ndarray  # shape (n,), m/s, NaN where unknown
    part: np.ndarray  # shape (n,), index of the segment or line; no road joins two of them


def legs_of_track(track: GeoTrack, pace: float | None = None) -> Legs:
    """Legs between points by times, else by speeds, else at a pace, m/s; or PlanError."""
    timed = np.isfinite(track.time)
    if len(np.unique(track.time[timed])) < 2:  # of no use, as those of a file's making
        timed = np.zeros_like(timed)
        track = _first_of_alternatives(track._replace(time=np.full(len(timed), np.nan)))
        timed = timed[: len(track.time)]
    place, time, speed, part = track
    if len(place) < 2:
        raise PlanError("it has no line with two points or more")
    place = place.copy()
    place[timed, :2] = without_wander(place[timed, :2], time[timed])
    if timed.all():
        place[:, :2] = without_noise(place[:, :2], time)
    steps = np.diff(way_length(*place[:, :2].T))
    apart = np.flatnonzero(np.diff(part))
    if timed.sum() > 1:
        apart, left_out = _pauses(time, apart)
        time = time - left_out
    _warn_of_ways(steps, apart)
    steps[apart] = 0.0
    if pace is not None and not (timed.any() or np.isfinite(speed).any()):
        speed = np.full_like(speed, pace)
    along = sums(steps)
    if driven := timed.sum() > 1:
        along = along - along[timed.argmax()]
        elapsed, way = time[timed], along[timed]
    else:
        if not np.isfinite(speed).all():
            raise PlanError(NEITHER)
        refuse(speed < 0, "speed is negative")
        length, mean = np.diff(along), (speed[1:] + speed[:-1]) / 2
        refuse((length > 0) & (mean <= 0), "it has no times, and its speed is 0")
        elapsed, way = sums(length / np.where(length > 0, mean, 1.0)), along
    heights = Heights(along, place[:, 2])
    if (np.diff(elapsed) >= 0.0).all():
        elapsed, way = with_borders(elapsed, way, heights.borders(MAX_POINTS - len(way)))
    legs = legs_between(elapsed, way, heights)
    if driven:  # heights as recorded
        seen = time[timed], way_length(*track.place[timed, :2].T)
        legs = replace(legs, commanded=is_trace(*seen))
    return legs


def _first_of_alternatives(track: GeoTrack) -> GeoTrack:
    """The first of lines that all have the same two ends, with a warning; others as they are."""
    last = np.append(np.flatnonzero(np.diff(track.part)), len(track.part) - 1)
    first = np.append(0, last[:-1] + 1)
    ends = track.place[np.array([first, last]), :2] if len(track.part) else np.zeros((2, 0, 2))
    alike = np.abs(ends - ends[:, :1]).max(initial=0.0) < ALIKE
    if len(last) < 2 or not alike or np.abs(ends[1] - ends[0]).max() < ALIKE:  # rounds of a loop
        return track
    warnings.warn(f"the first of {len(last)} lines with the same ends is taken", stacklevel=4)
    return GeoTrack(*(column[: last[0] + 1] for column in track))


def _warn_of_ways(steps: np.ndarray, apart: np.ndarray) -> None:
    """Warn of ways between points, m, that no line shows: between lines and far points."""
    if (gaps := steps[apart]).max(initial=0.0) > MEETING:
        warnings.warn(
            f"lines that do not meet, up to {gaps.max() / 1e3:.1f} km apart, follow each other; "
            "the ways between them are left out",
            stacklevel=4,
        )
    steps = np.delete(steps, apart)
    if steps[steps > FAR].sum() > 0.5 * steps.sum():
        warnings.warn(
            f"points are up to {steps.max() / 1e3:.1f} km apart; the road between them is assumed "
            "to be straight",
            stacklevel=4,
        )


def _pauses(time: np.ndarray, apart: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of points before pauses of over `LEAST_GAP`, and s of pauses up to each point."""
    timed = np.flatnonzero(np.isfinite(time))
    after = np.searchsorted(timed, apart, "right")
    apart, after = (border[(after > 0) & (after < len(timed))] for border in (apart, after))
    gap = time[timed[after]] - time[timed[after - 1]]
    pauses = np.zeros_like(time)
    pauses[timed[after]] = np.where(gap > LEAST_GAP, gap, 0.0)
    return apart[gap > LEAST_GAP], np.cumsum(pauses)


def gpx_track(content: bytes) -> GeoTrack:
    """The points of a GPX file's tracks, or of its routes if no track has times; PlanError."""
    reader = _Gpx()
    parser = XMLParser(target=reader)
    try:
        for begin in range(0, len(content), PIECE):  # refused content stops after its piece
            parser.feed(content[begin : begin + PIECE])
        parser.close()
        tracks = [_gpx_points(reader.points[kind]) for kind in POINTS]
    except (ParseError, LookupError, ValueError) as error:  # also for an invalid encoding
        raise PlanError(f"its XML is damaged: {error}") from error
    if not reader.is_gpx:
        raise PlanError("XML that is no GPX; export KML, TCX and others as GPX")
    timed = [track for track in tracks if np.isfinite(track.time).any()]
    return next(iter(timed), tracks[0] if len(tracks[0].place) else tracks[1])


class _Gpx:
    """Collects points while XML is parsed, without building a tree in memory."""

    def __init__(self) -> None:
        self.is_gpx = False
        self.points: dict[str, list[dict[str, str]]] = {kind: [] for kind in POINTS}
        self._point: dict[str, str] | None = None
        self._part = 0
        self._depth = 0
        self._text: list[str] = []

    def doctype(self, *_: object) -> None:
        raise PlanError("XML with a DOCTYPE, which may expand without end; no GPX has one")

    def start(self, tag: str, attributes: Mapping[str, str]) -> None:
        name = _local(tag)
        self.is_gpx |= name == "gpx"
        self._text = []
        self._depth += 1
        if self._depth > DEEPEST:
            raise PlanError(f"its XML is more than {DEEPEST} elements deep")
        self._part += name in PARTS
        if name in (*POINTS, SHAPE):
            if not {"lat", "lon"} <= attributes.keys():
                raise PlanError(f"a {name} has no lat or no lon")
            place = {name: attributes[name] for name in ("lat", "lon")}
            place["part"] = str(self._part)
            kind = "rtept" if name == SHAPE else name
            self.points[kind].append(place)
            self._point = self._point if name == SHAPE else place
            if len(self.points[kind]) > MOST_PLACES:
                raise PlanError(f"more than {MOST_PLACES} points")

    def data(self, text: str) -> None:
        if self._point is not None:
            self._text.append(text)

    def end(self, tag: str) -> None:
        name = _local(tag)
        self._depth -= 1
        if name in POINTS:
            self._point = None
        elif name in DETAILS and self._point is not None and (text := "".join(self._text).strip()):
            self._point[name] = text


def _local(tag: str) -> str:
    return tag.rpartition("}")[2]


def _gpx_points(points: Sequence[Mapping[str, str]]) -> GeoTrack:
    def numbers(name: str) -> np.ndarray:
        return np.array([point.get(name, "nan") for point in points], float)

    places = [[point["lon"], point["lat"], point.get("ele", "nan")] for point in points]
    time = _seconds([point.get("time") for point in points])
    place = np.array(places, float).reshape(-1, 3)
    return GeoTrack(place, time, numbers("speed"), numbers("part"))


def geojson_track(data: Mapping[str, Any]) -> GeoTrack:
    """The points of all lines, in order; PlanError if the number of times or speeds differs."""
    places: list[Sequence[float]] = []
    times: list[Any] = []
    speeds: list[Any] = []
    parts: list[int] = []
    for number, (line, given) in enumerate(_lines(data)):
        parts += [number] * len(line)
        places += [[*point[:3], np.nan][:3] for point in line]
        for names, collected in ((TIMES, times), (SPEEDS, speeds)):
            values = next((given[name] for name in names if given.get(name)), [None] * len(line))
            if len(values) != len(line):
                raise PlanError(f"{len(values)} {names[-1]} for {len(line)} points of a line")
            collected += values
    place = np.array(places, float).reshape(-1, 3)
    return GeoTrack(place, _seconds(times), np.array(speeds, float), np.array(parts))


def _lines(data: Mapping[str, Any]) -> Iterator[tuple[Sequence[Any], Mapping[str, Any]]]:
    if data["type"] == "FeatureCollection":
        for feature in data["features"]:
            yield from _lines(feature)
        return
    geometry = data["geometry"] if data["type"] == "Feature" else data
    properties = data.get("properties") or {}
    given = {**properties, **(properties.get("coordinateProperties") or {})}
    if geometry and geometry["type"] == "LineString":
        yield geometry["coordinates"], given
    elif geometry and geometry["type"] == "MultiLineString":
        for i, line in enumerate(geometry["coordinates"]):
            yield line, {name: given[name][i] for name in (*TIMES, *SPEEDS) if given.get(name)}


def _seconds(times: Sequence[Any]) -> np.ndarray:
    """Times, s, from ms since 1970 or ISO 8601 (UTC if no zone is given); NaN for None."""
    if not any(isinstance(time, str) for time in times):
        numbers = np.array(times, float)
        return numbers / 1e3 if (np.abs(numbers) > MILLISECONDS_FROM).any() else numbers
    texts = pl.Series(times, dtype=pl.String).str.strip_chars()
    zoned = texts.str.replace(r"(T\d\d:\d\d:\d\d(\.\d*)?)$", "${1}Z")
    micros = zoned.str.to_datetime("%+", time_unit="us", strict=False).to_physical()
    if (wrong := texts.is_not_null() & micros.is_null()).any():
        raise ValueError(f"{texts.filter(wrong)[0][:40]!r} is no time of ISO 8601")
    seconds: np.ndarray = (micros - (micros.min() or 0)).cast(pl.Float64).to_numpy() / 1e6
    return seconds
