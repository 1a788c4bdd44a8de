"""GPX and GeoJSON: places with times or speeds become legs, others are refused."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import PlanError, points_of
from evpinn_ros.core.energy.power_model import Weather, vehicle_model
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.plans.track import geojson_track, legs_of_track
from evpinn_ros.logs.plans.way import way_length, without_noise
from test.logs.plans import samples

DEGREE = math.radians(1.0) * 6_371_008.8  # m of a meridian
SECONDS = [0, 20, 20, 45, 105]  # one point twice, then a stop
NORTH = [0.0, 400.0, 400.0, 900.0, 900.0]  # m
CLOCK = [f"2024-05-01T10:{t // 60:02d}:{t % 60:02d}Z" for t in SECONDS]
HEIGHTS = [500.0, 504.0, 504.0, 509.0, 509.0]


def gpx(times=CLOCK, heights=HEIGHTS, speeds=None, kind="trk", version="1.1"):
    """Points to the north, one element a line, as watches and route services write them."""
    points = []
    for i, north in enumerate(NORTH):
        inner = f"<ele>{heights[i]}</ele>" if heights else ""
        inner += f"<time>{times[i]}</time>" if times and times[i] else ""
        if speeds and version == "1.0":
            inner += f"<speed>{speeds[i]}</speed>"
        elif speeds:
            inner += (f"<extensions><gpxtpx:TrackPointExtension><gpxtpx:speed>{speeds[i]}"
                      "</gpxtpx:speed></gpxtpx:TrackPointExtension></extensions>")  # fmt: skip
        point = "rtept" if kind == "rte" else "trkpt"
        points.append(f'<{point} lat="{48 + north / DEGREE:.8f}" lon="11.5">{inner}</{point}>')
    body = "\n".join(points)
    body = f"<rte>{body}</rte>" if kind == "rte" else f"<trk><trkseg>{body}</trkseg></trk>"
    number = version.replace(".", "/")
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="{version}" creator="test" '
        f'xmlns="http://www.topografix.com/GPX/{number}" '
        'xmlns:gpxtpx="http://www.garmin.com/xmlschemas/TrackPointExtension/v2">'
        f'<wpt lat="0" lon="0"><name>not of the track</name></wpt>{body}</gpx>'
    )


def geojson(kind="Feature", heights=HEIGHTS, **properties):
    line = [[11.5, 48 + north / DEGREE] for north in NORTH]
    line = [[*place, z] for place, z in zip(line, heights, strict=True)] if heights else line
    geometry = {"type": "LineString", "coordinates": line}
    feature = {"type": "Feature", "properties": properties, "geometry": geometry}
    if kind == "FeatureCollection":
        house = {"type": "Feature", "properties": None,
                 "geometry": {"type": "Point", "coordinates": [0.0, 0.0]}}  # fmt: skip
        return {"type": kind, "features": [house, feature]}
    return feature if kind == "Feature" else geometry


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("kind", ["gpx", "geojson"])
@pytest.mark.parametrize(("pause", "driven"), [(3600.0, 4000.0), (20.0, 4500.0)])
def test_what_lies_between_two_segments_is_no_road_but_where_reception_was_lost(
    read, kind, timed, pause, driven
):
    """A ferry of an hour, a tunnel of 20 s; without times nobody knows of the tunnel."""
    leap = 30e3 if pause > 60.0 else 500.0
    half = np.arange(0.0, 101.0, 10.0)
    north = np.concatenate((20.0 * half, 2000.0 + leap + 20.0 * half))
    time = np.concatenate((half, 100.0 + pause + half))
    if kind == "gpx":
        points = [
            f'<trkpt lat="{48 + y / DEGREE:.8f}" lon="11.5">'
            + (f"<time>{np.datetime64(1_714_557_600, 's') + int(t)}Z</time>" if timed
               else "<extensions><speed>20.0</speed></extensions>")
            + "</trkpt>"
            for y, t in zip(north, time, strict=True)
        ]  # fmt: skip
        segments = "".join(f"<trkseg>{''.join(p)}</trkseg>" for p in (points[:11], points[11:]))
        plan = read(f'<gpx version="1.1"><trk>{segments}</trk></gpx>')
    else:
        values = {"coordTimes": time.tolist()} if timed else {"speeds": [20.0] * 22}
        lines = [[[11.5, 48 + y / DEGREE] for y in part] for part in (north[:11], north[11:])]
        both = {name: [value[:11], value[11:]] for name, value in values.items()}
        shape = {"type": "MultiLineString", "coordinates": lines}
        plan = read({"type": "Feature", "properties": both, "geometry": shape})
    expected = driven if timed else 4000.0
    assert plan.length.sum() == pytest.approx(expected, rel=1e-3)
    assert plan.duration.sum() == pytest.approx(200.0 + (expected > 4000.0) * pause, rel=1e-3)


MILLIS = [1_714_557_600_000 + 1000 * t for t in SECONDS]
TRACKS = {
    "gpx 1.1": gpx(),
    "gpx 1.0": gpx(version="1.0"),
    "route of gpx": gpx(kind="rte"),
    "gpx in utf-16": gpx().replace("UTF-8", "UTF-16").encode("utf-16"),
    "gpx of a zone": gpx([clock.replace("Z", ".000+00:00") for clock in CLOCK]),
    "gpx without a zone": gpx([clock.rstrip("Z") for clock in CLOCK]),
    "coordTimes": geojson(coordTimes=CLOCK),
    "times, ms since 1970": geojson("FeatureCollection", times=MILLIS),
    "times, s": geojson(times=SECONDS),
    "coordinateProperties": geojson(coordinateProperties={"times": CLOCK}),
}


@pytest.mark.parametrize("track", TRACKS.values(), ids=TRACKS)
def test_places_with_times_are_legs_from_each_to_the_next(read, track):
    legs = read(track)
    at = [20.0, 45.0, 105.0]  # s; the last is a stop
    assert reached(at, legs.duration, legs.length) == pytest.approx([400, 900, 900], abs=0.01)
    assert legs.duration.sum() == pytest.approx(105.0)
    assert reached(at, legs.duration, legs.climb) == pytest.approx([4, 9, 9], abs=1.0)
    assert legs.height_known.all()


@pytest.mark.parametrize(
    "track",
    [
        gpx(heights=None),
        gpx(heights=5 * [0.0]),
        gpx(heights=5 * [-32768]),
        gpx(None, None, 5 * [10.0]),
        geojson(heights=None, coordTimes=CLOCK),
    ],
)
def test_places_without_heights_are_no_level_road(read, track):
    legs = read(track)
    assert not legs.height_known.any() and not points_of(legs).level


def level_route():
    answer = samples.graphhopper(["time"], encode=False)
    for place in answer["paths"][0]["points"]["coordinates"]:
        place[2] = 7.0
    return answer


EMPTY = ["500", "", " ", "504", "509"]  # heights, as of a receiver that lost them


@pytest.mark.parametrize(
    ("track", "said"),
    [
        (gpx(heights=[7.0] * 5), "equal, so the road is assumed to be level"),
        (geojson(heights=[7.0] * 5, coordTimes=CLOCK), "heights are equal"),
        (level_route(), "heights are equal"),
        (gpx(heights=EMPTY), "unknown at 2 of 5 places"),
        (gpx(heights=EMPTY).replace("<ele></ele>", "<ele/>"), "unknown at 2 of 5 places"),
        (geojson(heights=[500.0, None, None, 504.0, 509.0], coordTimes=CLOCK), "unknown at 2 of"),
    ],
)
def test_what_heights_leave_open_is_said(read, track, said):
    with pytest.warns(UserWarning, match=said):
        legs = read(track)
    assert legs.height_known.all()


def test_an_empty_element_is_one_that_is_missing(read):
    legs = read(gpx(CLOCK, [""] * 5))
    assert not legs.height_known.any()
    times = gpx([CLOCK[0], " ", "", CLOCK[3], CLOCK[4]], speeds=[""] * 5)
    assert read(times).duration.sum() == pytest.approx(105.0)


def reached(at, *steps):
    """Sums of steps of the second kind where those of the first have come so far."""
    along, sums = (np.concatenate(([0.0], np.cumsum(column))) for column in steps)
    return np.interp(at, along, sums)


def test_with_speeds_no_times_are_needed(read):
    speeds = [10.0, 30.0, 30.0, 20.0, 20.0]
    old, new = (gpx(times=None, speeds=speeds, version=version) for version in ("1.0", "1.1"))
    for track in (old, new, geojson(speeds=speeds)):
        legs = read(track)
        assert legs.length.sum() == pytest.approx(900.0, abs=0.01)
        assert reached([400.0, 900.0], legs.length, legs.duration) == pytest.approx([20.0, 40.0])
    with pytest.raises(PlanError, match="no times, and its speed is 0 at point 3"):
        read(gpx(times=None, speeds=[10.0, 10.0, 0.0, 0.0, 0.0]))
    with pytest.raises(PlanError, match="speed is negative at point 2"):
        read(gpx(times=None, speeds=[10.0, -10.0, 30.0, 0.0, 0.0]))


def test_points_without_a_time_lie_on_the_way_to_the_next(read):
    legs = read(gpx([None, CLOCK[1], None, None, CLOCK[4]]))
    assert legs.length.sum() == pytest.approx(500.0, abs=0.01)
    assert legs.length / legs.duration == pytest.approx(500.0 / 85.0)


@pytest.mark.parametrize("void", [-9999, -32768, 32767])
def test_a_void_of_the_map_hides_no_climb(read, void):
    legs = read(gpx(heights=[500.0, void, void, 509.0, 509.0]))
    assert legs.climb.sum() == pytest.approx(9.0, abs=1.0) and legs.height_known.all()


def test_a_height_that_leaps_adds_no_hill(read):
    leaping = [0.0, 0.0, 0.0, 505.0, 505.0]
    assert abs(read(gpx(heights=leaping)).climb).max() < 1.0


def test_the_track_with_times_is_taken_where_a_route_stands_beside_it(read):
    """As GraphHopper writes both."""
    route = gpx(times=None, kind="rte").partition("</wpt>")[2].removesuffix("</gpx>")
    assert read(gpx().replace("</wpt>", f"</wpt>{route}")).duration.sum() == pytest.approx(105.0)


@pytest.mark.parametrize(
    ("track", "reason"),
    [
        (gpx(times=None), "neither speeds nor times"),
        (gpx(CLOCK[::-1]), "time goes back at point 2"),
        (gpx(["soon"] * 5), "'soon' is no time of ISO 8601"),
        ('<!DOCTYPE gpx [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><gpx>&b;</gpx>', "DOCTYPE"),
        (geojson(times=SECONDS[1:]), "4 times for 5 points"),
    ],
)
def test_what_is_no_track_is_refused_with_the_reason(read, track, reason):
    with pytest.raises(PlanError, match=reason) as error:
        read(track, "track.gpx")
    assert "track.gpx: " in str(error.value)


def lines(*bounds, properties=None):
    """GeoJSON of lines to the north, from one distance, m, to another each, a point each 100 m."""
    line = [
        [
            [11.5, 48 + north / DEGREE]
            for north in np.linspace(*ends, 1 + abs(ends[1] - ends[0]) // 100)
        ]
        for ends in bounds
    ]
    features = [
        {"type": "Feature", "properties": properties or {},
         "geometry": {"type": "LineString", "coordinates": row}} for row in line
    ]  # fmt: skip
    return {"type": "FeatureCollection", "features": features}


@pytest.mark.parametrize(
    ("bounds", "length", "said"),
    [
        ([(0, 3000), (3000, 5000)], 5000.0, None),
        ([(0, 3000), (3000, 0)], 6000.0, None),
        ([(0, 3000), (0, 3000)], 3000.0, "the first of 2 lines with the same ends"),
        ([(0, 3000), (9000, 8000)], 4000.0, "up to 6.0 km apart, follow each other"),
    ],
    ids=["joined", "there and back", "alternatives", "apart"],
)
def test_of_lines_without_times_that_do_not_meet_it_is_said(at_pace, bounds, length, said):
    legs, warned = at_pace(lines(*bounds))
    assert legs.length.sum() == pytest.approx(length, rel=1e-3)
    assert [text for text in warned if said and said in text] == warned


def test_points_that_are_far_apart_are_joined_straight_and_that_is_said(at_pace):
    line = {"type": "LineString", "coordinates": [[11.5, 48.0], [11.5, 48.05], [11.5, 48.1]]}
    legs, warned = at_pace(line)
    assert legs.length.sum() == pytest.approx(0.1 * DEGREE)
    assert warned == [
        "points are up to 5.6 km apart; the road between them is assumed to be straight"
    ]


def test_a_garmin_route_goes_by_its_shape_not_straight(at_pace):
    """By its two points alone it is 5.6 km."""
    corner = (
        '<extensions><x:RoutePointExtension><x:rpt lat="48.05" lon="11.6"/>'
        "</x:RoutePointExtension></extensions>"
    )
    route = (
        '<gpx xmlns="http://www.topografix.com/GPX/1/1" xmlns:x="http://www.garmin.com/xmlschemas/'
        f'GpxExtensions/v3"><rte><rtept lat="48.05" lon="11.5">{corner}<ele>500</ele></rtept>'
        '<rtept lat="48.1" lon="11.6"/></rte></gpx>'
    )
    legs, _ = at_pace(route)
    east = 0.1 * DEGREE * math.cos(math.radians(48.05))
    assert legs.length.sum() == pytest.approx(east + 0.05 * DEGREE, rel=1e-3)


@pytest.mark.parametrize("clock", [[CLOCK[0], *[None] * 4], [CLOCK[0]] * 5], ids=["one", "same"])
def test_a_pace_serves_where_the_times_do_not_differ(at_pace, clock):
    legs, _ = at_pace(gpx(times=clock))
    assert legs.duration.sum() == pytest.approx(45.0)


@pytest.mark.parametrize("content", [gpx(), "length_km,speed_kmh\n1,50\n"], ids=["gpx", "legs"])
def test_a_pace_that_is_not_used_is_said(at_pace, content):
    _, warned = at_pace(content)
    assert warned[-1] == "the speed that was given is not used: this plan has its own"


def test_a_degree_is_as_long_as_on_earth():
    along = way_length(np.array([0.0, 1.0, 1.0]), np.array([60.0, 60.0, 61.0]))
    assert np.diff(along) == pytest.approx([DEGREE / 2, DEGREE], rel=1e-4)


def track_of(speeds, sigma=0.0, every=1):
    """GeoJSON to the east of speeds, m/s, a second apart; places wander where the car stands."""
    still = np.concatenate(([True], speeds == 0.0))
    noise = np.random.default_rng(7).normal(0.0, sigma, (2, len(still))) * still
    east, north = np.concatenate(([0.0], np.cumsum(speeds))) + noise[0], noise[1]
    x, y = 9.0 + east / DEGREE / math.cos(math.radians(48.0)), 48.0 + north / DEGREE
    line = np.stack((x, y), axis=1)[::every].tolist()
    times = np.arange(0.0, len(still), every).tolist()
    return {"type": "Feature", "properties": {"coordTimes": times},
            "geometry": {"type": "LineString", "coordinates": line}}  # fmt: skip


@pytest.mark.parametrize("sigma", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("every", [1, 2, 5])
@pytest.mark.parametrize("stands", [1, 4])
def test_a_receiver_that_stands_and_wanders_drives_nowhere(read, sigma, every, stands):
    """12 km with 20 minutes of standing: 13 to 21 km along its places."""
    ramp = np.arange(0.5, 15.0) * 4 / 3
    drive = np.concatenate((ramp, np.full(600 // stands, 20.0), ramp[::-1]))
    stand = np.zeros(1200 // stands)
    speeds = np.concatenate([drive, *[part for _ in range(stands) for part in (stand, drive)]])
    wandered, exact = (read(track_of(speeds, noise, every)) for noise in (sigma, 0.0))
    assert exact.length.sum() == pytest.approx(speeds.sum(), rel=1e-3)
    assert wandered.length.sum() == pytest.approx(speeds.sum(), rel=0.012 + 0.002 * stands)
    assert wandered.commanded
    assert energy_of(wandered) == pytest.approx(energy_of(exact), rel=0.05)


def energy_of(legs):
    return forecast_plan(legs, vehicle_model(load_vehicle("bmw_i3")), Weather(1.2)).energy[-1]


def shaken_track(speeds, radius, sigma, seconds, seed):
    """Along a bend, by a receiver whose error, m, lasts so many s on each axis."""
    angle = np.concatenate(([0.0], np.cumsum(speeds))) / radius
    north, east = radius * np.sin(angle), radius * (1.0 - np.cos(angle))
    white = np.random.default_rng(seed).normal(0.0, sigma, (len(angle), 2))
    kept = math.exp(-1.0 / seconds) if seconds else 0.0
    for i in range(1, len(white)):
        white[i] = kept * white[i - 1] + math.sqrt(1.0 - kept**2) * white[i]
    place = np.column_stack((north, east)) + white
    place = place / DEGREE / [1.0, math.cos(math.radians(48.0))] + [48.0, 9.0]
    lines = place[:, ::-1].tolist()
    times = np.arange(0.0, len(lines)).tolist()
    return {"type": "Feature", "properties": {"coordTimes": times},
            "geometry": {"type": "LineString", "coordinates": lines}}  # fmt: skip


RAMP = np.arange(0.5, 25.0)
STEADY = np.concatenate((RAMP, np.full(500, 25.0), RAMP[::-1]))
IN_TOWN = np.tile(np.concatenate((RAMP[:14], np.full(40, 14.0), RAMP[13::-1], np.zeros(15))), 8)


@settings(max_examples=25, deadline=None)
@given(
    town=st.booleans(),
    radius=st.sampled_from([400.0, 1500.0, 1e6]),
    sigma=st.floats(2.0, 3.0),
    seconds=st.sampled_from([0.0, 5.0, 15.0, 30.0, 100.0]),
    seed=st.integers(0, 99),
)
def test_the_noise_of_a_receiver_is_no_acceleration(town, radius, sigma, seconds, seed):
    """At 90 km/h once a second, white noise of 2 m made 190 %, of half a minute 17 % more."""

    speeds = IN_TOWN if town else STEADY

    def legs(noise):
        track = geojson_track(shaken_track(speeds, radius, noise, seconds, seed))
        return legs_of_track(track)

    exact, shaken = legs(0.0), legs(sigma)
    assert exact.length.sum() == pytest.approx(speeds.sum(), rel=1e-3)
    share = 0.05 if town else 0.03
    assert energy_of(shaken) == pytest.approx(energy_of(exact), rel=share)
    assert shaken.length.sum() == pytest.approx(speeds.sum(), rel=0.015)


@pytest.mark.parametrize("every", [1, 2, 5])
def test_places_without_noise_are_kept(every):
    track = geojson_track(shaken_track(IN_TOWN, 400.0, 0.0, 0.0, 0))
    place, time = track.place[::every, :2], track.time[::every]
    assert without_noise(place, time) is place


@pytest.mark.parametrize("speed", [0.7, 1.5, 5.0])
def test_who_creeps_does_not_stand(read, speed):
    creeping = np.concatenate((np.full(60, 10.0), np.full(300, speed), np.zeros(60)))
    assert read(track_of(creeping)).length.sum() == pytest.approx(creeping.sum(), rel=1e-3)
