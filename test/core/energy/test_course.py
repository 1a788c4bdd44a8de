"""A plan is a function of the road: what its points and borders say twice changes nothing."""

from dataclasses import replace
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.edges import edge_energies
from evpinn_ros.core.energy.forecast import PlanBasis, forecast_plan
from evpinn_ros.core.energy.path_plan import plan_from_path
from evpinn_ros.core.energy.plan import (
    Legs,
    Plan,
    PlanConditions,
    legs_of,
    legs_of_trip,
    plan_from_speed_profile,
    points_of,
)
from evpinn_ros.core.energy.power_model import PowerModel, vehicle_model
from evpinn_ros.core.vehicle.files import load_vehicle
from test.core.energy.cars import FEW, taught

EXACT = {"rel": 1e-9, "abs": 1e-4}
CARS = st.sampled_from(["bmw_i3", "generic", "taught"])
LEG = st.tuples(st.floats(2.0, 900.0), st.floats(0.6, 36.0) | st.just(0.0), st.floats(-0.08, 0.08))
POINT = st.tuples(st.floats(0.5, 900.0), st.floats(0.0, 36.0), st.floats(-0.05, 0.05))
CONDITIONS = st.builds(
    PlanConditions,
    temperature=st.none() | st.floats(-20.0, 40.0),
    heating=st.none() | st.floats(0.0, 5000.0),
    head_wind=st.none() | st.floats(-10.0, 15.0),
    stood=st.none() | st.floats(0.0, 1e5),
    steady=st.sampled_from([None, 0.0, 1.0]),
)


def car(name: str) -> PowerModel:
    return taught() if name == "taught" else vehicle_model(load_vehicle(name))


def basis_of(name: str, conditions: PlanConditions, fading: bool) -> PlanBasis:
    """The car and conditions; with a wind that was measured, which fades along the way."""
    basis = PlanBasis.of(car(name), conditions)
    return basis._replace(head_wind=basis.head_wind or 6.0, wind_length=5e3) if fading else basis


def cuts(draw, count: int) -> list[np.ndarray]:
    """Shares at which each of so many pieces is cut, at places of chance; at least one is."""
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    numbers = rng.integers(0, 5, count) * (rng.uniform(size=count) < 0.5)
    numbers[int(rng.integers(count))] = draw(st.integers(1, 60))
    return [np.sort(rng.uniform(0.0, 1.0, number)) for number in numbers]


def cut_legs(legs: Legs, shares: list[np.ndarray]) -> Legs:
    """Legs cut in two or more at shares of their durations."""
    parts = [np.diff(np.concatenate(([0.0], share, [1.0]))) for share in shares]
    columns = (
        np.concatenate([value * part for value, part in zip(column, parts, strict=True)])
        for column in (legs.length, legs.duration, legs.climb)
    )
    return legs_of_trip(*columns)


def cut_points(plan: Plan, shares: list[np.ndarray]) -> Plan:
    """A plan with points added on its lines, at shares of their durations."""
    rows = []
    for leg, share in enumerate(shares):
        duration = plan.time[leg + 1] - plan.time[leg]
        start, end = plan.speed[leg : leg + 2]
        speed = start + share * (end - start)
        way = (start + speed) / 2.0 * share * duration
        whole = plan.distance[leg + 1] - plan.distance[leg]
        height = plan.elevation[leg] + np.divide(way, whole or 1.0) * np.diff(plan.elevation)[leg]
        rows.append([[column[leg]] for column in columns_of(plan)])
        distance = np.minimum(plan.distance[leg] + way, plan.distance[leg + 1])  # but for rounding
        rows.append([plan.time[leg] + share * duration, distance, speed, height])
    rows.append([[column[-1]] for column in columns_of(plan)])
    return replace(
        plan, **dict(zip(NAMES, map(np.concatenate, zip(*rows, strict=True)), strict=True))
    )


NAMES = ("time", "distance", "speed", "elevation")


def columns_of(plan: Plan) -> list[np.ndarray]:
    return [getattr(plan, name) for name in NAMES]


def same(one, other, times: np.ndarray, others: np.ndarray) -> None:
    """Two forecasts agree at the end, at the points that both have, and all along their curves."""
    at = [int(np.abs(others - time).argmin()) for time in times]
    assert one.energy == pytest.approx(other.energy[at], **EXACT)
    assert one.sigma == pytest.approx(other.sigma[at], rel=1e-8, abs=1e-3)
    assert one.curve.time[-1] == pytest.approx(other.curve.time[-1], rel=1e-12)
    where = np.linspace(0.0, one.curve.distance[-1], 20)
    curves = [np.interp(where, result.curve.distance, result.curve.energy)
              for result in (one, other)]  # fmt: skip
    if (np.diff(one.curve.distance) > 0.0).all():  # else energy leaps where it stands
        assert curves[0] == pytest.approx(curves[1], rel=1e-8, abs=1e-2)
    ends = (result.end[1:] for result in (one, other))
    assert next(ends) == pytest.approx(next(ends), rel=1e-8, abs=1e-6)


@FEW
@given(st.data(), CARS, st.lists(LEG, min_size=1, max_size=8), CONDITIONS, st.booleans())
def test_legs_cut_at_random_take_the_same(data, name, rows, conditions, fading):
    duration, speed, slope = np.array(rows).T
    legs = legs_of_trip(duration * speed, duration, slope * duration * speed)
    if not legs.length.any():
        return
    basis = basis_of(name, conditions, fading)
    finer = cut_legs(legs, cuts(data.draw, len(rows)))
    whole, parts = (forecast_plan(plan, *basis) for plan in (legs, finer))
    same(whole, parts, points_of(legs).time, points_of(finer).time)
    ends = (forecast_plan(plan, *basis, along=False) for plan in (legs, finer))
    for result in ends:
        assert result.energy[-1] == pytest.approx(whole.energy[-1], **EXACT)
        assert result.sigma[-1] == pytest.approx(whole.sigma[-1], rel=1e-8)


@FEW
@given(st.data(), CARS, st.lists(POINT, min_size=2, max_size=8), CONDITIONS, st.booleans())
def test_points_added_on_lines_change_nothing(data, name, rows, conditions, fading):
    step, speed, slope = np.array(rows).T
    profile = plan_from_speed_profile(np.cumsum(step), None, speed)
    rise = np.concatenate(([0.0], np.cumsum(slope[1:] * np.diff(profile.distance))))
    plan = replace(profile, elevation=rise)
    shares = cuts(data.draw, len(rows) - 1)
    beside = data.draw(st.sampled_from([1e-9, 1e-3]))  # of a point that is there
    shares = [np.unique(np.append(share, (beside, 1.0 - beside))) for share in shares]
    finer = cut_points(plan, shares)
    basis = basis_of(name, conditions, fading)
    whole, parts = (forecast_plan(trip, *basis) for trip in (plan, finer))
    same(whole, parts, plan.time, finer.time)


def test_a_dense_curve_is_no_line():
    """Each of its points lies almost on the line between its neighbours."""
    basis = PlanBasis.of(car("bmw_i3"), PlanConditions())
    energies = []
    for rate in (2, 49):  # Hz
        time = np.linspace(0.0, 300.0, 300 * rate + 1)
        plan = plan_from_speed_profile(time, None, 15.0 + 5.0 * np.sin(time / 30.0))
        energies.append(forecast_plan(plan, *basis).energy[-1])
        path = plan_from_path(plan.distance, 0.0 * time, 0.0 * time, time)
        assert path.speed == pytest.approx(plan.speed, abs=5e-3)
    assert energies == pytest.approx(energies[:1] * 2, rel=5e-4)


@FEW
@given(st.data(), st.lists(LEG, min_size=1, max_size=8), st.booleans())
def test_poses_added_on_a_path_change_nothing(data, rows, stamped):
    duration, speed, slope = np.array(rows).T
    length = duration * np.minimum(speed, 9.0) + 1.0
    rng = np.random.default_rng(len(rows))
    turns = np.cumsum(rng.uniform(-1.5, 1.5, len(rows)))
    steps = length * np.stack((np.cos(turns), np.sin(turns), slope))
    corners = np.concatenate((np.zeros((3, 1)), np.cumsum(steps, axis=1)), axis=1)
    time = np.concatenate(([0.0], np.cumsum(duration)))
    shares = cuts(data.draw, len(rows))
    at = np.concatenate([[*(leg + np.append(0.0, share))] for leg, share in enumerate(shares)])
    at = np.append(np.unique(at), len(rows))
    numbers = np.arange(len(rows) + 1)
    plans = []
    for places in (numbers, at):
        xyz = (np.interp(places, numbers, axis) for axis in corners)
        stamps = np.interp(places, numbers, time) if stamped else None
        plans.append(plan_from_path(*xyz, stamps))
    basis = PlanBasis.of(vehicle_model(load_vehicle("generic")), PlanConditions())
    whole, parts = (forecast_plan(plan, *basis) for plan in plans)
    assert parts.energy[-1] == pytest.approx(whole.energy[-1], rel=1e-7, abs=1.0)
    assert parts.sigma[-1] == pytest.approx(whole.sigma[-1], rel=1e-6)
    assert parts.time[-1] == pytest.approx(whole.time[-1], rel=1e-9)


@FEW
@given(st.data(), CARS, st.lists(LEG, min_size=1, max_size=8), CONDITIONS)
def test_the_sum_over_edges_is_that_of_the_road_however_it_is_cut(data, name, rows, conditions):
    duration, speed, slope = np.array(rows).T
    basis = PlanBasis.of(car(name), conditions)
    legs = legs_of(duration * speed, duration, slope * duration * speed)
    finer = cut_legs(legs, cuts(data.draw, len(rows)))
    whole, parts = (
        edge_energies(road, basis.model, basis.weather, basis.head_wind, steady=bool(basis.steady))
        for road in (legs, finer)
    )
    assert parts.energy.sum() == pytest.approx(whole.energy.sum(), **EXACT)
    order = range(len(rows)), range(len(finer.length))
    routes = [road.route(numbers) for road, numbers in zip((whole, parts), order, strict=True)]
    assert routes[0].value == pytest.approx(routes[1].value, **EXACT)


def test_a_road_of_one_speed_takes_about_as_much_as_legs_as_a_line_and_as_edges():
    """10 km at 72 km/h with a start and a stop: physics says 1.05 to 1.12 kWh at even speed."""
    basis = PlanBasis.of(car("bmw_i3"), PlanConditions(steady=1.0))
    legs = legs_of_trip([10e3], [500.0])
    line = Plan(*np.array([[0.0, 500.0], [0.0, 10e3], [20.0, 20.0], [0.0, 0.0]]))
    edges = edge_energies(legs, basis.model, basis.weather, steady=True)
    kwh = [float(forecast_plan(plan, *basis).energy[-1]) / 3.6e6 for plan in (legs, line)]
    kwh.append(float(edges.energy[0]) / 3.6e6)
    assert min(kwh) > 1.04 and max(kwh) < 1.14
    uneven = basis._replace(steady=False)
    for plan in (legs, line):
        assert 1.2 < float(forecast_plan(plan, *uneven).energy[-1]) / 3.6e6 < 1.5


@pytest.mark.parametrize("apart", [0.015, 0.03])
def test_legs_within_two_percent_are_one_run(apart):
    """Durations that a service rounds are no change of speed; larger differences are."""
    duration = np.where(np.arange(100) % 2, 60.0, 60.0 * (1.0 + apart))
    legs = legs_of_trip(np.full(100, 1200.0), duration)
    basis = PlanBasis.of(car("bmw_i3"), PlanConditions())
    forecast = forecast_plan(legs, *basis)
    run = forecast_plan(legs_of_trip([120e3], [duration.sum()]), *basis)
    same_energy = math.isclose(forecast.energy[-1], run.energy[-1], rel_tol=2e-3)
    assert same_energy == (apart < 0.02)
