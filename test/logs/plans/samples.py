"""Answers of route services for one road, in the forms of their documentation; numbers our own."""

from collections.abc import Sequence
import math

# The road: due north from here, so that a length is a latitude alone.
SOUTH, EAST = 48.1, 11.5
EARTH_RADIUS = 6_371_008.8
LENGTHS = [400.0, 800.0, 5000.0, 1800.0]  # m
DURATIONS = [70.0, 64.0, 180.0, 120.0]  # s
HEIGHTS = [500.0, 504.0, 500.0, 600.0, 590.0]  # m, at the ends of the legs
TOTAL, DURATION = sum(LENGTHS), sum(DURATIONS)


def encoded(rows: Sequence[Sequence[float]], scales: Sequence[float]) -> str:
    """Points as the documentation of encoded polylines has it, number by number."""
    text, before = "", [0] * len(scales)
    for row in rows:
        now = [round(value * scale) for value, scale in zip(row, scales, strict=True)]
        for step in (new - old for new, old in zip(now, before, strict=True)):
            left = ~(step << 1) if step < 0 else step << 1
            while left >= 0x20:
                text += chr((0x20 | (left & 0x1F)) + 63)
                left >>= 5
            text += chr(left + 63)
        before = now
    return text


def places(points_a_leg: int = 20) -> list[tuple[float, float, float]]:
    """Latitude, longitude and height, some points to a leg."""
    points, along = [], 0.0
    for length, low, high in zip(LENGTHS, HEIGHTS[:-1], HEIGHTS[1:], strict=True):
        for i in range(points_a_leg):
            part = i / points_a_leg
            north = math.degrees((along + part * length) / EARTH_RADIUS)
            points.append((SOUTH + north, EAST, low + part * (high - low)))
        along += length
    return [*points, (SOUTH + math.degrees(TOTAL / EARTH_RADIUS), EAST, HEIGHTS[-1])]


def height_at(along: float) -> float:
    """Height of the road, m."""
    for length, low, high in zip(LENGTHS, HEIGHTS[:-1], HEIGHTS[1:], strict=True):
        if along <= length:
            return low + along / length * (high - low)
        along -= length
    return HEIGHTS[-1]


def valhalla(units: str = "kilometers") -> dict:
    unit, foot = (1000.0, 1.0) if units == "kilometers" else (1609.344, 0.3048)
    maneuvers = [
        {"type": 1, "time": time, "length": length / unit, "begin_shape_index": i}
        for i, (length, time) in enumerate(zip(LENGTHS, DURATIONS, strict=True))
    ]
    maneuvers.append({"type": 4, "time": 0.0, "length": 0.0, "begin_shape_index": 4})
    steps = int(TOTAL / 30.0) + 2  # the last is the end, which may be nearer
    leg = {
        "maneuvers": maneuvers,
        "summary": {"time": DURATION, "length": TOTAL / unit},
        "shape": encoded([place[:2] for place in places()], [1e6, 1e6]),
        "elevation_interval": 30.0 / foot,
        "elevation": [height_at(min(30.0 * i, TOTAL)) / foot for i in range(steps)],
    }
    return {"trip": {"status": 0, "status_message": "Found route between points",
                     "units": units, "language": "en-US", "legs": [leg],
                     "summary": leg["summary"]}}  # fmt: skip


def valhalla_edges(timed: bool = True) -> dict:
    edges, elapsed = [], 0.0
    for i, (length, time) in enumerate(zip(LENGTHS, DURATIONS, strict=True)):
        elapsed += time
        mean = 32768 if i == 3 else (HEIGHTS[i] + HEIGHTS[i + 1]) / 2
        edge = {"length": length / 1000, "speed": 3.6 * length / time}
        edge |= {"speed_limit": 50, "mean_elevation": mean}
        edges.append(edge | ({"end_node": {"elapsed_time": elapsed}} if timed else {}))
    return {"units": "kilometers", "shape": "", "edges": edges}


def osrm(annotated: bool = True, steps: bool = True) -> dict:
    annotation = {
        "distance": LENGTHS,
        "duration": [0.9 * time for time in DURATIONS],  # turns are in the leg's alone
        "nodes": [1, 2, 3, 4, 5],
        "maxspeed": [{"speed": 50, "unit": "km/h"}] * 3 + [{"none": True}],
    }
    made = [
        {"distance": length, "duration": time, "mode": "driving", "maneuver": {"type": "turn"}}
        for length, time in zip(LENGTHS, DURATIONS, strict=True)
    ]
    made.append({"distance": 0, "duration": 0, "maneuver": {"type": "arrive"}})
    leg = {"distance": TOTAL, "duration": DURATION, "steps": made if steps else []}
    leg |= {"annotation": annotation} if annotated else {}
    route = {"distance": TOTAL, "duration": DURATION, "weight_name": "routability", "legs": [leg],
             "geometry": encoded([place[:2] for place in places()], [1e5, 1e5])}  # fmt: skip
    return {"code": "Ok", "routes": [route], "waypoints": []}


def graphhopper(details: Sequence[str] = (), encode: bool = True, up: bool = True) -> dict:
    n = 20
    spans = [(n * i, n * (i + 1)) for i in range(4)]
    made = {
        "time": [[*span, int(1000 * t)] for span, t in zip(spans, DURATIONS, strict=True)],
        "average_speed": [[*span, 3.6 * length / time] for span, length, time
                          in zip(spans, LENGTHS, DURATIONS, strict=True)],
    }  # fmt: skip
    points = places(n)
    scales = [1e5, 1e5, 100.0][: 3 if up else 2]
    line = encoded([place[: len(scales)] for place in points], scales)
    plain = [[x, y, z][: len(scales)] for y, x, z in points]
    parts = [
        {"distance": length, "time": int(1000 * time), "interval": [*span], "sign": 0}
        for length, time, span in zip(LENGTHS, DURATIONS, spans, strict=True)
    ]
    parts.append({"distance": 0.0, "time": 0, "interval": [80, 80], "sign": 4})
    path = {
        "distance": TOTAL,
        "time": int(1000 * DURATION),
        "points_encoded": encode,
        "points": line if encode else {"type": "LineString", "coordinates": plain},
        "instructions": parts,
        "details": {name: made[name] for name in details},
    }
    return {"paths": [path], "info": {"took": 3}}


def openrouteservice(form: str = "json", units: str = "m", steps: bool = True) -> dict:
    unit = {"m": 1.0, "km": 1000.0, "mi": 1609.344}[units]
    made = [
        {
            "distance": length / unit,
            "duration": time,
            "type": 1,
            "way_points": [20 * i, 20 * i + 20],
        }
        for i, (length, time) in enumerate(zip(LENGTHS, DURATIONS, strict=True))
    ]
    made.append({"distance": 0.0, "duration": 0.0, "type": 10, "way_points": [80, 80]})
    segment = {"distance": TOTAL / unit, "duration": DURATION, "steps": made if steps else []}
    route = {"summary": {"distance": TOTAL / unit, "duration": DURATION}, "segments": [segment],
             "way_points": [0, 80]}  # fmt: skip
    metadata = {"service": "routing", "query": {"units": units, "elevation": True}}
    if form == "geojson":
        line = [[x, y, z] for y, x, z in places()]
        feature = {"type": "Feature", "properties": route,
                   "geometry": {"type": "LineString", "coordinates": line}}  # fmt: skip
        return {"type": "FeatureCollection", "features": [feature], "metadata": metadata}
    route["geometry"] = encoded(places(), [1e5, 1e5, 100.0])
    return {"routes": [route], "metadata": metadata}
