"""Edges, routes, forecasts and range are one function; what two routes share cancels."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.edges import edge_energies
from evpinn_ros.core.energy.forecast import PlanBasis, forecast_plan
from evpinn_ros.core.energy.plan import PlanConditions, legs_of, legs_of_trip
from evpinn_ros.core.energy.power_model import PowerModel, Weather, even_steps, vehicle_model
from evpinn_ros.core.energy.remaining import usual_cost
from evpinn_ros.core.estimation.even import Path
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.terms import WARM, Warmth
from evpinn_ros.core.estimation.unevenness import MIDDLES, USUAL_LEG, Unevenness
from evpinn_ros.core.vehicle.files import load_vehicle
from test.core.energy.cars import FEW, taught

CARS = st.sampled_from(["bmw_i3", "nissan_leaf", "generic", "taught"])
LEGS = st.lists(
    st.tuples(st.floats(2.0, 900.0), st.floats(0.6, 36.0), st.floats(-0.08, 0.08)),
    min_size=1,
    max_size=12,
)
CONDITIONS = st.builds(
    PlanConditions,
    temperature=st.none() | st.floats(-20.0, 40.0),
    heating=st.none() | st.floats(0.0, 5000.0),
    head_wind=st.none() | st.floats(-10.0, 15.0),
    payload=st.none() | st.floats(0.0, 400.0),
    stood=st.none() | st.floats(0.0, 1e5),
)


def car(name: str) -> PowerModel:
    return taught() if name == "taught" else vehicle_model(load_vehicle(name))


@FEW
@given(CARS, LEGS, CONDITIONS)
def test_a_route_is_the_forecast_of_its_edges(name, rows, conditions):
    duration, speed, slope = np.array(rows).T
    length, climb = duration * speed, slope * duration * speed
    basis = PlanBasis.of(car(name), conditions)
    edges = edge_energies(
        legs_of(length, duration, climb), basis.model, basis.weather, basis.head_wind
    )
    order = np.random.default_rng(len(rows)).integers(0, len(rows), 2 * len(rows))
    route = edges.route(order)
    trip = forecast_plan(legs_of_trip(length[order], duration[order], climb[order]), *basis)
    assert route.value == pytest.approx(trip.energy[-1], rel=1e-9, abs=1e-6)
    assert route.sigma == pytest.approx(trip.sigma[-1], rel=1e-9)


@FEW
@given(CARS, LEGS, CONDITIONS)
def test_an_edge_at_even_speed_is_a_leg_within_a_long_road_of_its_kind(name, rows, conditions):
    """With tyres and cabin warm; but for the load that fades. Both ends are minutes away."""
    basis = PlanBasis.of(car(name), conditions)
    weather = basis.weather._replace(start=WARM)
    mean = basis.model.car.mean.copy()
    mean[State.LOAD] = 0.0
    model = PowerModel(replace(basis.model.car, mean=mean))
    duration, speed, slope = np.array(rows).T
    columns = duration * speed, duration, slope * duration * speed
    edges = edge_energies(legs_of(*columns), model, weather, basis.head_wind, steady=True)
    for edge, leg in enumerate(zip(*columns, strict=True)):
        legs = legs_of_trip(*(value * np.array([300.0, 1.0, 300.0]) for value in leg))
        energy = forecast_plan(legs, model, weather, basis.head_wind, steady=True).energy
        assert edges.energy[edge] == pytest.approx(energy[2] - energy[1], rel=1e-6, abs=1.0)


@pytest.mark.parametrize("celsius", [None, -15.0, 30.0])
@pytest.mark.parametrize("name", ["bmw_i3", "taught"])
def test_the_usual_cost_of_range_is_that_of_edges(name, celsius):
    """In the air of now, for a car whose drives never end."""
    warm = replace(car(name).car, seconds=1e6, celsius=celsius)
    metres = 1000.0 * np.arange(1.0, len(MIDDLES) + 1.0)
    model = PowerModel(replace(warm, unevenness=replace(Unevenness.none(), metres=metres)))
    legs = legs_of(MIDDLES * USUAL_LEG, np.full_like(MIDDLES, USUAL_LEG), np.zeros_like(MIDDLES))
    weather = PlanBasis.of(model, PlanConditions(temperature=celsius)).weather
    edges = edge_energies(legs, model, weather)
    cost = np.average(edges.energy / legs.length, weights=metres)
    assert usual_cost(model.car) == pytest.approx(cost, rel=1e-9)


@FEW
@given(CARS, st.floats(600.0, 4000.0), st.sampled_from(MIDDLES[2:]), st.floats(-20.0, 40.0))
def test_the_usual_cost_of_range_has_the_starts_of_the_drives(name, seconds, speed, celsius):
    """Of drives of this length, each of which begins cold."""
    new = replace(car(name).car, celsius=celsius)
    duration = np.full(int(seconds), seconds / int(seconds))
    length = speed * duration
    drive = Path(duration, length, speed**2 * length, *(0.0 * length for _ in range(4)))
    uneven = Unevenness.none().after(new.equation, new.mean, drive)
    endless = replace(uneven, cold=np.zeros(2))
    often, never = (usual_cost(replace(new, unevenness=u)) for u in (uneven, endless))
    model = PowerModel(new)
    steps, density = even_steps(duration, length, 0.0 * length), model.density()
    cold, warm = (
        float((model.rows(steps, Weather(density, start=start)) @ new.mean).sum())
        for start in (Warmth.after(0.0), WARM)
    )
    assert length.sum() * (often - never) == pytest.approx(cold - warm)
