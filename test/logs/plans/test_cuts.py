"""A road cut at random takes the same in every format of a file."""

from datetime import datetime, timedelta, timezone
import json
import math

import numpy as np
import pytest

from evpinn_ros.api.plan import as_plan, planned_energy
from evpinn_ros.core.energy.plan import PlanConditions, sums
from evpinn_ros.core.vehicle.files import load_vehicle
from test.logs.plans.samples import EARTH_RADIUS

CAR = load_vehicle("bmw_i3")
START = datetime(2024, 5, 1, 10, tzinfo=timezone.utc)


def table(header, *columns):
    rows = (",".join(map(repr, row)) for row in np.transpose(columns).tolist())
    return "\n".join([header, *rows, ""])


def places(length, climb):
    """Longitude, latitude, degrees, and height, m, at the ends of legs along a great circle."""
    along, start, heading = sums(length) / EARTH_RADIUS, math.radians(48.1), 0.7
    north = np.cos(along) * np.sin(start) + np.sin(along) * np.cos(start) * np.cos(heading)
    east = np.sin(heading) * np.sin(along) * np.cos(start)
    longitude = np.arctan2(east, np.cos(along) - np.sin(start) * north)
    return np.degrees([longitude, np.arcsin(north)]).tolist(), (500.0 + sums(climb)).tolist()


def gpx(duration, length, climb, timed=True):
    (x, y), z = places(length, climb)
    clock = [(START + timedelta(seconds=t)).isoformat() for t in sums(duration).tolist()]
    points = (
        f'<trkpt lat="{lat!r}" lon="{lon!r}"><ele>{up!r}</ele>'
        + f"<time>{time}</time>" * timed
        + "</trkpt>"
        for lon, lat, up, time in zip(x, y, z, clock, strict=True)
    )
    return f'<gpx version="1.1"><trk><trkseg>{"".join(points)}</trkseg></trk></gpx>'


def line(length, climb):
    (x, y), z = places(length, climb)
    return {"type": "LineString", "coordinates": [list(p) for p in zip(x, y, z, strict=True)]}


def geojson(duration, length, climb):
    given = {"times": sums(duration).tolist()}
    return {"type": "Feature", "properties": given, "geometry": line(length, climb)}


def osrm(duration, length, climb):
    steps = [{"distance": a, "duration": b} for a, b in zip(length, duration, strict=True)]
    leg = {"distance": sum(length), "duration": sum(duration), "steps": steps}
    return {"code": "Ok", "routes": [{"legs": [leg]}]}


def annotated(duration, length, climb):
    leg = {"distance": sum(length), "duration": sum(duration)}
    given = {"distance": length.tolist(), "duration": duration.tolist()}
    return {"code": "Ok", "routes": [{"legs": [leg | {"annotation": given}]}]}


def valhalla(duration, length, climb):
    made = [{"time": b, "length": a / 1e3} for a, b in zip(length, duration, strict=True)]
    return {"trip": {"units": "kilometers", "legs": [{"maneuvers": made}]}}


def graphhopper(duration, length, climb):
    made = [
        {"distance": a, "time": 1e3 * b, "interval": [i, i + 1]}
        for i, (a, b) in enumerate(zip(length, duration, strict=True))
    ]
    path = {"distance": sum(length), "time": 1e3 * sum(duration), "instructions": made}
    return {"paths": [path | {"points": line(length, climb)}]}


def openrouteservice(duration, length, climb):
    steps = [
        {"distance": a, "duration": b, "way_points": [i, i + 1]}
        for i, (a, b) in enumerate(zip(length, duration, strict=True))
    ]
    segment = {"distance": sum(length), "duration": sum(duration), "steps": steps}
    route = {"type": "Feature", "properties": {"segments": [segment]}}
    return {"type": "FeatureCollection", "features": [route | {"geometry": line(length, climb)}]}


FORMATS = {
    "legs.csv": lambda t, s, h: table("length_m,duration_s,climb_m", s, t, h),
    "speeds.csv": lambda t, s, h: table(
        "length_km,speed_kmh,grade_percent", s / 1e3, 3.6 * s / t, 100 * np.tan(np.arcsin(h / s))
    ),
    "timed.gpx": gpx,
    "bare.gpx": lambda t, s, h: gpx(t, s, h, timed=False),
    "line.geojson": geojson,
    "osrm.json": osrm,
    "annotation.json": annotated,
    "valhalla.json": valhalla,
    "graphhopper.json": graphhopper,
    "openrouteservice.json": openrouteservice,
}
PROFILES = {
    "lines.csv": lambda t, v, h: table("t_s,speed_mps,elevation_m", t, v, h),
    "slopes.csv": lambda t, v, h: table("t_min,speed_mps,grade_percent", t / 60, v, 0 * t + 3),
    "drive.csv": lambda t, v, h: table("time [s],Speed [km/h],Altitude [m]", t, 3.6 * v, h),
}  # fmt: skip


def cut_legs(name, seed):
    """Duration, length and climb of legs, and of the parts of these."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 6))
    duration, speed = rng.uniform(30.0, 900.0, count).round(), rng.uniform(3.0, 33.0, count)
    climb = rng.uniform(-0.04, 0.04, count) * duration * speed
    parts = [rng.dirichlet(np.ones(cuts)) for cuts in rng.integers(1, (4, 40, 400)[seed], count)]
    whole = np.stack((duration, duration * speed, climb))
    cut = np.hstack([leg[:, None] * part for leg, part in zip(whole.T, parts, strict=True)])
    return whole, cut


def cut_lines(name, seed):
    """Time, speed and height, and with rows between that lie on lines of speed."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 6))
    time, speed = sums(rng.uniform(60.0, 900.0, count)), rng.uniform(0.0, 33.0, count + 1)
    way = sums(np.diff(time) * (speed[1:] + speed[:-1]) / 2.0)
    height = np.interp(way, way[::2], 500.0 + 0.01 * way[::2])
    every = 9.0 if name == "drive.csv" else 0.5  # closer rows of a drive are as driven
    finer = np.unique(np.concatenate((time, np.arange(0.0, time[-1], every))))
    fast = np.interp(finer, time, speed)
    along = sums(np.diff(finer) * (fast[1:] + fast[:-1]) / 2.0)
    return (time, speed, height), (finer, fast, np.interp(along, way, height))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("name", "write", "cut"),
    [
        *((name, write, cut_legs) for name, write in FORMATS.items()),
        *((name, write, cut_lines) for name, write in PROFILES.items()),
    ],
)
def test_a_plan_cut_at_random_takes_the_same(tmp_path, name, write, cut, seed):
    figures = []
    for columns in cut(name, seed):
        path, content = tmp_path / name, write(*columns)
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        plan = as_plan(path, CAR, 72.0 if name == "bare.gpx" else None)
        planned = planned_energy(plan, CAR, PlanConditions(charge=0.3))
        assert not plan.commanded or name == "slopes.csv"
        energies, trip = planned.energies, planned.trip
        ends = (energies.energy, energies.sigma, trip.time, trip.distance, *planned.charge)
        figures.append([*(end[-1] for end in ends), planned.empty_at or 0.0])
    assert figures[1] == pytest.approx(figures[0], rel=1e-9, abs=1e-9)
