"""Answers of route services become the same legs, whoever answers and in whatever form."""

from contextlib import suppress
from copy import deepcopy

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import Legs, PlanError
from evpinn_ros.core.energy.power_model import Weather, vehicle_model
from evpinn_ros.core.estimation.even import runs_of
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.plans.route import decode_polyline
from test.logs.plans import samples

CLIMBS = np.diff(samples.HEIGHTS)
ANSWERS = {
    "valhalla": (samples.valhalla(), True),
    "valhalla in miles": (samples.valhalla("miles"), True),
    "osrm with annotation": (samples.osrm(), False),
    "osrm with steps": (samples.osrm(annotated=False), False),
    "graphhopper with instructions": (samples.graphhopper(), True),
    "graphhopper with details": (samples.graphhopper(["time"]), True),
    "graphhopper by speed, not encoded": (
        samples.graphhopper(["average_speed"], encode=False),
        True,
    ),
    "graphhopper in the plane": (samples.graphhopper(["time"], up=False), False),
    "openrouteservice": (samples.openrouteservice(), True),
    "openrouteservice as geojson in km": (samples.openrouteservice("geojson", "km"), True),
}


def joined(legs: Legs) -> Legs:
    """Legs without the borders within a part of one speed, where heights alone are taken."""
    begins = np.flatnonzero(np.diff(runs_of(legs.duration, legs.length), prepend=-1))
    columns = (legs.length, legs.duration, legs.climb)
    sums = (np.add.reduceat(column, begins) for column in columns)
    return Legs(*sums, np.logical_or.reduceat(legs.height_known, begins))


@pytest.mark.parametrize(("answer", "heights"), ANSWERS.values(), ids=ANSWERS)
def test_every_service_gives_the_legs_of_the_road(read, answer, heights):
    legs = joined(read(answer))
    assert legs.length == pytest.approx(samples.LENGTHS, abs=1.0)
    assert legs.duration == pytest.approx(samples.DURATIONS)
    assert (legs.height_known == heights).all()
    # Heights are smoothed over 50 m, which rounds the road at the ends of its legs.
    assert legs.climb == pytest.approx(CLIMBS if heights else 0 * CLIMBS, abs=1.5)


@pytest.mark.parametrize("timed", [True, False], ids=["by elapsed time", "by speed"])
def test_edges_of_valhalla_have_mean_heights(read, timed):
    legs = joined(read(samples.valhalla_edges(timed)))
    assert legs.length == pytest.approx(samples.LENGTHS)
    assert legs.duration == pytest.approx(samples.DURATIONS)
    assert legs.height_known.tolist() == [True, True, True, False]  # 32768 of the last is unknown
    assert legs.climb[2] > 25.0  # of the half whose height is known


@pytest.mark.parametrize(
    "answer",
    [
        samples.osrm(annotated=False, steps=False),
        samples.openrouteservice(units="mi", steps=False),
        {"paths": [{"distance": samples.TOTAL, "time": 1000 * samples.DURATION}]},
        {
            "trip": {
                "legs": [{"summary": {"length": samples.TOTAL / 1000, "time": samples.DURATION}}]
            }
        },
    ],
    ids=["osrm", "openrouteservice", "graphhopper", "valhalla"],
)
def test_without_steps_the_route_is_one_leg(read, answer):
    legs = joined(read(answer))
    assert legs.length == pytest.approx([samples.TOTAL])
    assert legs.duration == pytest.approx([samples.DURATION])


def test_edges_of_a_service_are_no_finer_than_its_steps(read):
    """An edge has the speed of its class of road: that a driver is as steady is not said."""
    fine = samples.osrm()
    given = fine["routes"][0]["legs"][0]["annotation"]
    for name in ("distance", "duration"):
        given[name] = np.repeat(np.array(given[name]) / 20, 20).tolist()
    edges, steps = read(fine), read(samples.osrm(annotated=False))
    assert edges.duration.min() >= 60.0
    car = vehicle_model(load_vehicle("bmw_i3"))
    of_edges, of_steps = (forecast_plan(legs, car, Weather(1.2)) for legs in (edges, steps))
    # Legs of a minute have less speeding up and braking than those of minutes, but edges of
    # seconds would have next to none.
    uneven, all_of_it = (
        forecast.energy[-1] - forecast_plan(legs, car, Weather(1.2), steady=True).energy[-1]
        for forecast, legs in ((of_edges, edges), (of_steps, steps))
    )
    assert 0.6 * all_of_it < uneven <= all_of_it
    assert of_edges.sigma[-1] == pytest.approx(of_steps.sigma[-1], rel=0.1)


def test_a_part_without_duration_belongs_to_the_next(read):
    """As Valhalla rounds short maneuvers; the whole keeps its length."""
    answer = samples.valhalla()
    maneuvers = answer["trip"]["legs"][0]["maneuvers"]
    maneuvers.insert(0, {"length": 0.1, "time": 0})
    maneuvers.append({"length": 0.02, "time": 0})
    legs = joined(read(answer))
    assert legs.length == pytest.approx([500.0, 800.0, 5000.0, 1820.0])
    assert legs.duration == pytest.approx(samples.DURATIONS)


SPANS = [[0, 40, 0], [40, 60, 1], [60, 80, 0]]  # points of the third part's line


def spans(road, ferry):
    return {"values": [[begin, end, (road, ferry)[is_]] for begin, end, is_ in SPANS]}


def with_third_part(answer, place, name, value):
    """The answer with the third of the parts at a place named so."""
    parts = answer
    for step in place:
        parts = parts[step]
    parts[2][name] = value
    return answer


OSRM = "routes", 0, "legs", 0, "steps"
VALHALLA = "trip", "legs", 0, "maneuvers"
FERRIES = {
    "osrm": with_third_part(samples.osrm(annotated=False), OSRM, "mode", "ferry"),
    "osrm annotated": with_third_part(samples.osrm(), OSRM, "mode", "train"),
    "valhalla": with_third_part(samples.valhalla(), VALHALLA, "ferry", True),
    "valhalla by type, miles": with_third_part(samples.valhalla("miles"), VALHALLA, "type", 28),
    "valhalla's edges": with_third_part(samples.valhalla_edges(), ["edges"], "use", "ferry"),
    "train": with_third_part(samples.valhalla_edges(timed=False), ["edges"], "use", "rail-ferry"),
    "graphhopper by sign": with_third_part(
        samples.graphhopper(), ("paths", 0, "instructions"), "sign", 9
    ),
}
for form in (["time"], ["average_speed"], []):
    answer = samples.graphhopper(form)
    answer["paths"][0]["details"]["road_environment"] = spans("road", "ferry")["values"]
    FERRIES[f"graphhopper {form}"] = answer
for name, ferry in (("waycategory", 8), ("waycategory", 9), ("waytypes", 9)):
    answer = samples.openrouteservice()
    answer["routes"][0]["extras"] = {name: spans(1, ferry)}
    FERRIES[f"openrouteservice {name} {ferry}"] = answer


@pytest.mark.parametrize("answer", FERRIES.values(), ids=FERRIES)
def test_what_a_ferry_or_a_train_carries_is_not_driven(read, answer):
    with pytest.warns(UserWarning, match="5.0 km and 3 min on a ferry or a train are left out"):
        legs = joined(read(answer))
    assert legs.length == pytest.approx([400.0, 800.0, 1800.0], abs=1.0)
    assert legs.duration == pytest.approx([70.0, 64.0, 120.0])
    assert legs.climb[legs.height_known] == pytest.approx(
        np.array([4.0, -4.0, -10.0])[legs.height_known], abs=5.0
    )


def test_a_ferry_that_is_hidden_in_a_part_is_refused(read):
    answer = samples.openrouteservice()
    answer["routes"][0]["extras"] = {"waycategory": {"values": [[0, 40, 1], [40, 50, 8]]}}
    with pytest.raises(PlanError, match="a part of it is partly on a ferry or a train"):
        read(answer)
    hidden = samples.valhalla()
    hidden["trip"]["legs"][0]["summary"]["has_ferry"] = True
    with pytest.raises(PlanError, match="a part of it is partly on a ferry or a train"):
        read(hidden)
    whole = samples.osrm(annotated=False)
    for step in whole["routes"][0]["legs"][0]["steps"]:
        step["mode"] = "ferry"
    with (
        pytest.warns(UserWarning),
        pytest.raises(PlanError, match="on a ferry or a train"),
    ):
        read(whole)


SLOW = {"distance": 10e3, "duration": 3600.0}
UNTOLD = {
    "osrm": {"routes": [{"legs": [SLOW]}]},
    "valhalla's edges": {
        "edges": [{"length": 10.0, "speed": 10.0}, {"length": 1.0, "speed": 72.0}]
    },
    "graphhopper": {"paths": [{"distance": 10e3, "time": 3_600_000}]},
    "openrouteservice": {"routes": [{"segments": [SLOW]}]},
}


@pytest.mark.parametrize("answer", UNTOLD.values(), ids=UNTOLD)
def test_where_no_ferry_is_told_a_part_that_is_as_slow_is_said(read, answer):
    with pytest.warns(UserWarning, match="10.0 km takes 60 min and counts as driven"):
        read(answer)


def repeated(answer, kind, name):
    """The answer with its route twice, as the service's other kinds of answer have it."""
    (route,) = answer[kind]
    others = {key: value for key, value in answer.items() if key != kind}
    return others | {name: [route, deepcopy(route)]}


@pytest.mark.parametrize("kind", ["matchings", "trips"])
def test_all_pieces_of_a_matched_trace_are_driven(read, kind):
    answer = repeated(samples.osrm(), "routes", kind)
    with pytest.warns(UserWarning, match=f"2 {kind} follow each other"):
        legs = joined(read(answer))
    assert legs.length == pytest.approx(samples.LENGTHS * 2)
    assert legs.duration == pytest.approx(samples.DURATIONS * 2)


@pytest.mark.parametrize(
    "answer",
    [
        repeated(samples.osrm(), "routes", "routes"),
        repeated(samples.graphhopper(), "paths", "paths"),
        repeated(samples.openrouteservice("geojson"), "features", "features"),
        samples.valhalla() | {"alternates": [samples.valhalla()]},
    ],
    ids=["osrm", "graphhopper", "openrouteservice", "valhalla"],
)
def test_the_first_of_several_routes_is_taken_and_said(read, answer):
    with pytest.warns(UserWarning, match="the first of 2 routes is taken"):
        assert joined(read(answer)).length == pytest.approx(samples.LENGTHS, abs=1.0)


def test_legs_of_several_waypoints_follow_each_other(read):
    answer = samples.valhalla()
    (leg,) = answer["trip"]["legs"]
    answer["trip"]["legs"] = [leg, deepcopy(leg)]
    legs = joined(read(answer))
    assert legs.length == pytest.approx(samples.LENGTHS * 2)
    assert legs.climb[5:7].sum() == pytest.approx(CLIMBS[1:3].sum(), abs=3.0)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ({"code": "NoRoute", "message": "Impossible route"}, "no route: Impossible route"),
        ({"error_code": 442, "error": "No path could be found", "status_code": 400}, "No path"),
        ({"error": {"code": 2010, "message": "no routable point"}}, "no route: no routable point"),
        ({"message": "Cannot find point 2", "hints": []}, "no route: Cannot find point 2"),
        ({"routes": [], "code": "Ok"}, "there is no route in this answer"),
        ({"vehicle": "bmw_i3"}, "known are GeoJSON and the answers of Valhalla"),
        *(
            ({"routes": [route], "status": "OK"}, "Google's is one.: known are GeoJSON")
            for route in (
                {"legs": [{"distance": {"text": "12 km", "value": 12000}, "duration": {}}]},
                {"legs": [{"distanceMeters": 12000, "duration": "600s"}], "polyline": {}},
                {"sections": [{"summary": {"length": 12000}}]},
            )
        ),
        ({"routes": {"features": []}, "messages": []}, "Google's is one.: known are GeoJSON"),
        ({"error": {"description": "no route"}}, "found no route: no route"),
        ({"units": "kilometers", "edges": [{"length": 1, "speed": 0}]}, "speed 0 at part 1"),
        (
            {"routes": [{"legs": [{"distance": 9e3, "duration": None}]}]},
            "length or time is unknown",
        ),
        ([{"length_km": 1, "duration_min": 1}], "JSON of no known kind"),
        ({"routes": [{"legs": [{"distance": 9e3, "duration": 2}]}]}, "lengths in m, durations"),
    ],
)
def test_what_is_no_route_is_refused_with_the_reason(read, answer, reason):
    with pytest.raises(PlanError, match=reason) as error:
        read(answer, "route.json")
    assert "route.json: " in str(error.value) and "\n" not in str(error.value)


def test_a_polyline_is_that_of_its_documentation():
    """The example of Google's page on the algorithm."""
    places = decode_polyline("_p~iF~ps|U_ulLnnqC_mqNvxq`@", 1e5, 2)
    assert places.tolist() == [[38.5, -120.2], [40.7, -120.95], [43.252, -126.453]]


@given(
    st.lists(
        st.tuples(st.floats(-90, 90), st.floats(-180, 180), st.floats(-400, 9000)), min_size=1
    ),
    st.sampled_from([1e5, 1e6]),
    st.sampled_from([2, 3]),
)
def test_a_polyline_comes_back(points, scale, dimensions):
    rows = [point[:dimensions] for point in points]
    scales = [scale, scale, 100.0][:dimensions]
    decoded = decode_polyline(samples.encoded(rows, scales), scale, dimensions)
    np.testing.assert_allclose(decoded, rows, atol=0.51 / min(scales[-1], scale), rtol=0)


@settings(max_examples=25)
@given(st.text(max_size=40), st.sampled_from([2, 3]))
def test_any_text_is_a_polyline_or_refused(text, dimensions):
    with suppress(PlanError):
        assert decode_polyline(text, 1e5, dimensions).shape[1] == dimensions


def test_a_polyline_that_is_too_long_is_refused():
    with pytest.raises(PlanError, match="more than 800000 characters"):
        decode_polyline("?" * 800_001, 1e5, 2)
