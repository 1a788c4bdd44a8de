"""Conditions of plans: what a planner gives, else the last known."""

from dataclasses import replace
import math
from types import SimpleNamespace

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

import evpinn_ros as ev
from evpinn_ros.core.energy.battery_model import BatteryModel
from evpinn_ros.core.energy.charge import UNKNOWN, Uncertain
from evpinn_ros.core.energy.forecast import Air, PlanBasis, Profiles, forecast, forecast_plan
from evpinn_ros.core.energy.forecaster import Basis, Forecaster
from evpinn_ros.core.energy.plan import (
    PlanConditions,
    PlanError,
    Question,
    plan_from_speed_profile,
)
from evpinn_ros.core.energy.power_model import CLIMATE_SHARE, PowerModel, vehicle_model
from evpinn_ros.core.signals.readings import TemperatureReading, WindReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.topics.messages import BadMessage
from evpinn_ros.topics.plans import read_conditions
from test.core.energy.cars import COMBINED, SIGMAS, taught

CAR = load_vehicle("bmw_i3")
TIME = np.arange(0.0, 601.0, 10.0)
TRIP = plan_from_speed_profile(TIME, None, np.minimum(20.0, 2.0 * np.minimum(TIME, 600.0 - TIME)))


def answer(forecaster: Forecaster, charge: Uncertain = UNKNOWN):
    capacity = Uncertain(CAR.battery_capacity, 1e6)
    return forecaster.answer(TRIP, charge, capacity, 0, BatteryModel(CAR.battery_capacity))


def energy(**given: float) -> float:
    forecaster = Forecaster(CAR)
    forecaster.set_conditions(PlanConditions(**given))
    return float(answer(forecaster).forecast.energy[-1])


def message(**given: float):
    return SimpleNamespace(name=[*given], position=[*given.values()], velocity=[], effort=[])


def test_cold_wind_and_payload_cost_and_a_tail_wind_gives():
    plain = energy()
    assert energy(temperature=-10.0) > 1.1 * plain
    assert energy(heating=4000.0) > energy(heating=0.0) + 0.99 * 600 * 4000.0
    assert energy(head_wind=10.0) > plain > energy(head_wind=-10.0)
    assert energy(payload=300.0) > plain


@given(st.floats(-25.0, 40.0), st.sampled_from([0.0, 3000.0, None]), st.sampled_from([0.0, 1e4]))
@settings(max_examples=20, deadline=None)
def test_one_temperature_gives_one_number_wherever_it_comes_from(celsius, heating, stood):
    """As last measured by the car, by a reading just now, or as a planner says."""
    car = replace(taught().car, celsius=celsius)
    unlike = replace(car, celsius=11.0 - celsius)
    conditions = PlanConditions(heating=heating, stood=stood)
    cases = (
        (car, conditions, Air()),
        (unlike, conditions, Air(celsius=celsius)),
        (unlike, replace(conditions, temperature=celsius), Air(celsius=-celsius)),
    )
    trips = [
        forecast_plan(TRIP, *PlanBasis.of(PowerModel(learned), said, air))
        for learned, said, air in cases
    ]
    for trip in trips[1:]:
        assert (trip.energy == trips[0].energy).all() and (trip.sigma == trips[0].sigma).all()
    profiles = Profiles(TRIP.time, TRIP.speed[None])
    same = forecast(
        profiles, CAR, PowerModel(car), air_density=PowerModel(unlike).density(celsius)
    )
    assert forecast(profiles, CAR, PowerModel(car)).energy[0] == same.energy[0]


@pytest.mark.parametrize("learned", [False, True])
def test_hours_since_the_last_drive_cool_the_car_also_when_nothing_was_learned(learned):
    model = taught() if learned else vehicle_model(CAR)
    energies = [
        forecast_plan(TRIP, *PlanBasis.of(model, PlanConditions(temperature=-5.0, stood=stood)))
        for stood in (0.0, 1800.0, 1e8)
    ]
    warm, cooler, cold = (float(trip.energy[-1]) for trip in energies)
    assert warm < cooler < cold
    if not learned:
        assert cold == energy(temperature=-5.0)


@pytest.mark.parametrize("points", [50, 20_000])
def test_wind_that_is_stated_stays_and_that_of_now_fades(points):
    def more(length: float, wind: float, fades: bool) -> float:
        time = np.linspace(0.0, length / 14.0, points)
        forecaster, plan = Forecaster(CAR), plan_from_speed_profile(time, None, 14.0 + 0.0 * time)
        calm = forecaster.answer(plan, UNKNOWN, UNKNOWN, 0, BatteryModel(math.nan)).forecast
        if fades:
            forecaster.set_air(WindReading(0, wind), 0)
        else:
            forecaster.set_conditions(PlanConditions(head_wind=wind))
        windy = forecaster.answer(plan, UNKNOWN, UNKNOWN, 0, BatteryModel(math.nan)).forecast
        return float(windy.energy[-1] - calm.energy[-1])

    drag_area, eta = CAR.frontal_area * CAR.priors["c_d"].value, CAR.priors["eta"].value
    physics = 0.5 * CAR.air_density * drag_area / eta * (24.0**2 - 14.0**2) * 50e3
    assert more(50e3, 10.0, False) == pytest.approx(physics, rel=0.15)
    assert more(200e3, 10.0, False) == pytest.approx(4.0 * more(50e3, 10.0, False), rel=0.02)
    assert 0.0 < more(50e3, 10.0, True) < 0.2 * physics


def test_air_is_known_for_half_an_hour_and_a_learned_car_until_another_is_learned():
    forecaster, car = Forecaster(CAR), vehicle_model(CAR).car
    forecaster.set_air(TemperatureReading(0, -10.0), 0)
    assert [forecaster.air(m * 60 * 10**9).celsius for m in (29, 31)] == [-10.0, None]
    forecaster.set_model(replace(car, mean=1.5 * car.mean))
    learned = answer(forecaster).forecast.energy[-1]
    forecaster.set_identifiable(COMBINED, SIGMAS)  # says less, and comes each second too
    assert answer(forecaster).forecast.energy[-1] == learned
    assert forecaster.basis is Basis.MODEL


def test_heating_that_nobody_gives_strays_from_what_cold_makes_likely():
    """By two fifths before a drive; once the drive has shown its heating, no more."""
    car = vehicle_model(CAR).car
    sure = replace(car, covariance=np.zeros_like(car.covariance), load_variance=0.0)

    def sigma(seconds: float, **given: float) -> float:
        forecaster = Forecaster(CAR)
        forecaster.set_model(replace(sure, seconds=seconds))
        forecaster.set_conditions(PlanConditions(**given))
        return float(answer(forecaster).forecast.sigma[-1])

    least = sigma(0.0, temperature=-10.0, heating=2000.0)
    heating = energy(temperature=-10.0) - energy(temperature=-10.0, heating=0.0)
    unknown = math.hypot(least, CLIMATE_SHARE * heating)
    assert sigma(0.0, temperature=-10.0) == pytest.approx(unknown, rel=1e-3)
    assert sigma(7200.0, temperature=-10.0) == pytest.approx(least, rel=1e-3)


def test_a_car_that_stood_is_cold_again_and_a_prewarmed_cabin_saves():
    """A drive of two hours warmed it; then it stands: not at all, an hour, a night."""
    forecaster, car = Forecaster(CAR), replace(vehicle_model(CAR).car, celsius=-10.0)

    def cost(seconds: float, **given: float) -> float:
        forecaster.set_model(replace(car, seconds=seconds))
        forecaster.set_conditions(PlanConditions(**given))
        return float(answer(forecaster).forecast.energy[-1])

    warm, hour, night = cost(7200.0), cost(7200.0, stood=3600.0), cost(7200.0, stood=36e3)
    assert warm < hour < night == pytest.approx(cost(0.0), rel=1e-3)
    assert warm < cost(7200.0, stood=36e3, prewarmed=1.0) < night
    car = replace(car, last_drive=7200.0)  # as from a file: another drive, so it is cold
    assert cost(0.0) == pytest.approx(night, rel=1e-3)
    assert cost(0.0, stood=3600.0) == pytest.approx(hour, rel=1e-3)


def test_the_charge_of_a_plan_is_where_it_begins():
    forecaster = Forecaster(CAR)
    now = answer(forecaster, Uncertain(0.5, 0.01)).charge.value
    forecaster.set_conditions(PlanConditions(charge=0.9))
    assert answer(forecaster, Uncertain(0.5, 0.01)).charge.value == pytest.approx(now + 0.4)


def test_a_named_vector_gives_what_it_names():
    conditions = read_conditions(message(temperature=-5.0, heating=math.nan, charge=0.8))
    assert conditions == PlanConditions(temperature=-5.0, charge=0.8)
    assert conditions.given == ("temperature", "charge")
    assert read_conditions(message()) == PlanConditions()


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (message(temperature=400.0), "out_of_range"),
        (message(payload=math.inf), "out_of_range"),
        (message(humidity=0.3), "unknown_name"),
        (SimpleNamespace(name=["heating"], position=[]), "lengths_differ"),
        (SimpleNamespace(name=["heating", "heating"], position=[1.0, 2.0]), "lengths_differ"),
    ],
)
def test_what_no_trip_has_is_refused(given, reason):
    with pytest.raises(BadMessage, match=reason):
        read_conditions(given)


def test_conditions_of_one_plan_go_before_those_of_all_and_the_answer_has_both():
    forecaster = Forecaster(CAR)
    forecaster.set_air(TemperatureReading(0, 8.0), 0)
    forecaster.set_conditions(PlanConditions(payload=150.0, heating=500.0))
    capacity = Uncertain(CAR.battery_capacity, 1e6)

    def ask(**given: float):
        asked = TRIP, UNKNOWN, capacity, 0, BatteryModel(CAR.battery_capacity)
        question = Question("", conditions=PlanConditions(**given))
        return forecaster.answer(*asked, question)

    usual, own = ask(), ask(heating=0.0, charge=0.5)
    assert usual.conditions == ("heating", "payload")
    assert own.conditions == ("heating", "payload", "charge")
    taken = {"temperature": 8.0, "heating": 500.0, "payload": 150.0}
    assert usual.assumed == taken | {"head_wind": 0.0, "prewarmed": 0.0, "steady": 0.0}
    assert own.assumed == usual.assumed | {"heating": 0.0, "charge": 0.5}
    assert own.charge.known and not usual.charge.known
    assert ask().forecast.energy[-1] == usual.forecast.energy[-1] > own.forecast.energy[-1]


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"charge_pct": 180.0}, "a state of charge of 180 is not within 0 to 100 percent"),
        ({"charge_pct": -1.0}, "a state of charge of -1 is not"),
        ({"stood_h": -2.0}, "the car cannot have stood for -2 h"),
    ],
)
def test_what_people_give_is_refused_in_their_units(given, reason):
    with pytest.raises(PlanError, match=reason):
        ev.forecast({"length_km": [9], "speed_kmh": [50]}, "bmw_i3", **given)


def test_a_share_that_is_none_is_named():
    for name in ("charge", "prewarmed", "steady"):
        with pytest.raises(PlanError, match=f"{name}: 180 is not a share"):
            PlanConditions(**{name: 180.0})
    with pytest.raises(PlanError, match="temperature is 99, not -60 to 60"):
        PlanConditions(temperature=99.0)
