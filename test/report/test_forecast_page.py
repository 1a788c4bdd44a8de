"""The page of `evpinn forecast --report`, and what its figures are made of."""

from dataclasses import replace
from functools import cache
import math
import re

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

import evpinn_ros as ev
from evpinn_ros.api.plan import level_road, planned_energy, until_empty, what_if
from evpinn_ros.common.units import METRIC
from evpinn_ros.core.energy.battery_model import BatteryModel
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.forecast import forecast_plan, plan_parts
from evpinn_ros.core.energy.forecaster import Forecaster
from evpinn_ros.core.energy.plan import Legs, PlanConditions, legs_of_trip, plan_from_speed_profile
from evpinn_ros.core.energy.power_model import PowerModel
from evpinn_ros.core.estimation.bands import TrackRecord
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.terms import WHOLE, Part
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.report.forecast_page import PlannedTrip, _curves, _sentence, write_forecasts

TIME = np.arange(0.0, 601.0, 2.0)
SPEED = np.minimum(20.0, np.minimum(TIME, 600.0 - TIME)) * (1.0 + 0.1 * np.sin(TIME / 20.0))
FINE = plan_from_speed_profile(TIME, None, SPEED, 0.004 * TIME)
COARSE = legs_of_trip(
    length=np.array([600.0, 0.0, 7000.0]),
    duration=np.array([60.0, 90.0, 350.0]),
    climb=np.array([0.0, 0.0, 40.0]),
)
FEW = plan_from_speed_profile(
    np.array([0.0, 20.0, 580.0, 600.0]), None, np.array([0.0, 20.0, 20.0, 0.0])
)
COLD = PlanConditions(temperature=-10.0, head_wind=5.0)


@pytest.mark.parametrize("plan", [FINE, COARSE])
def test_parts_add_up_to_the_forecast(plan):
    planned = planned_energy(plan, "bmw_i3", COLD)
    energy, sigma = plan_parts(plan, planned.energies, *planned.basis)
    whole = energy[WHOLE].sum() + energy[-1]
    assert whole == pytest.approx(planned.energies.energy[-1], rel=1e-9)
    uneven = energy[-1]
    assert uneven > 1e4 if plan is COARSE else abs(uneven) < 1.0
    assert energy[Part.SLOPE] > 0.0 and energy[Part.CLIMATE] > 0.0
    assert (sigma[[Part.AIR, Part.TYRES]] > 0.0).all()


@pytest.mark.parametrize("plan", [FEW, COARSE])
def test_the_part_of_uneven_speed_is_what_steady_leaves_out(plan):
    planned = planned_energy(plan, "bmw_i3", COLD)
    steady = planned_energy(plan, "bmw_i3", replace(COLD, steady=1.0))
    less = planned.energies.energy[-1] - steady.energies.energy[-1]
    assert planned.uneven == pytest.approx(less, rel=0.02) and less > 1e4
    assert abs(steady.uneven) < 0.02 * less
    assert planned.energies.time.tolist() == steady.energies.time.tolist()


def test_a_plan_unlike_what_was_driven_says_so():
    """Town has taught all of the car but its drag: a motorway is the vehicle file's."""
    planned = planned_energy(FINE, "bmw_i3")
    car = planned.basis.model.car
    share = np.full(len(car.mean), 0.1)
    share[State.DRAG_AREA_OVER_ETA] = 1.0
    learned = replace(
        car,
        covariance=share[:, None] * car.covariance * share,
        record=TrackRecord(drives=5.0),
    )

    def said(speed: float, of: CarModel) -> bool:
        steady = plan_from_speed_profile(TIME, None, np.full_like(TIME, speed))
        energies = forecast_plan(steady, PowerModel(of), *planned.basis[1:])
        basis = planned.basis._replace(model=PowerModel(of))
        return planned._replace(energies=energies, basis=basis).beyond_driven is not None

    assert [said(speed, learned) for speed in (8.0, 14.0, 40.0)] == [False, False, True]
    assert not said(40.0, replace(learned, record=TrackRecord()))


@pytest.mark.parametrize("plan", [FEW, COARSE])
@pytest.mark.parametrize("given", ["all", "none", "some"])
def test_a_plan_without_heights_says_so_and_is_less_sure(plan, given):
    """On the page and in the command; where only a part of the way has heights, which."""
    if isinstance(plan, Legs):
        known = {"all": (True, True), "none": (False, False), "some": (True, False)}[given]
        plan = replace(plan, height_known=np.array([known[0], known[0], known[1]]))
    elif given == "all":
        plan = replace(plan, elevation=0.01 * plan.distance)
    planned = planned_energy(plan, "bmw_i3", COLD)
    text = planned.no_heights()
    if given == "some" and isinstance(plan, Legs):
        assert text.startswith("no heights for 7.0 of 7.6 km: a level road is assumed")
    else:
        assert (text is None) == (given == "all")
    assert ("level road" in _sentence(planned, METRIC)) == (text is not None)
    end = planned.energies.end
    growth = planned.basis.model.car.growth * planned.basis.model.car.weight_over_eta**2
    level = replace(planned.basis.model.car, growth=0.0)
    sure = forecast_plan(plan, PowerModel(level), *planned.basis[1:]).sigma[-1]
    more = planned.energies.sigma[-1] ** 2 - sure**2
    assert more == pytest.approx(level.trust * growth * end.unseen, rel=1e-6, abs=1e-3)


def test_faster_takes_more_and_less_time_and_colder_takes_more():
    variants = {variant.words: variant for variant in what_if(FINE, "bmw_i3", COLD)}
    slower, faster = variants["10 km/h slower"], variants["10 km/h faster"]
    assert slower.energy.value < 0.0 < faster.energy.value
    assert faster.seconds < 0.0 < slower.seconds
    assert variants["10 °C warmer"].energy.value < 0.0 < variants["10 °C colder"].energy.value
    sigma = planned_energy(FINE, "bmw_i3", COLD).energies.sigma[-1]
    assert all(variant.energy.sigma < 0.7 * sigma for variant in variants.values())


@pytest.mark.parametrize("charge", [0.05, 0.03, 0.01])
def test_the_battery_is_empty_where_its_energy_is_used_up_and_the_page_says_it(charge):
    """Wherever the points lie."""
    coarse = legs_of_trip(np.array([40e3, 10e3]), np.array([1800.0, 600.0]))
    planned = planned_energy(coarse, "bmw_i3", PlanConditions(charge=charge))
    curve = planned.energies.curve
    where = float(np.interp(charge * planned.gauge.capacity.value, curve.energy, curve.distance))
    assert 0.0 < where < 40e3 and planned.empty_at == pytest.approx(where)
    assert f"empty after {where / 1e3:.1f} km" in _sentence(planned, METRIC)
    assert planned_energy(coarse, "bmw_i3", PlanConditions(charge=0.0)).empty_at == 0.0
    assert planned_energy(coarse, "bmw_i3", PlanConditions(charge=1.0)).empty_at is None
    assert planned_energy(coarse, "bmw_i3").empty_at is None


@cache
def drained_car():
    """A car whose battery learned its voltage and capacity from 95 % down by a seventh."""
    car = ev.Estimator("bmw_i3")
    charge = 0.95
    for second in range(500):
        current = 70.0 + 60.0 * math.sin(second / 17.0)
        voltage = 372.0 + 55.0 * (charge - 0.5) - 0.17 * current
        car.add(float(second), 15.0, voltage, current, soc_pct=100.0 * charge)
        charge -= current / (62.0 * 3600.0)
    assert car.account.battery.known and car.account.gauge.learned
    return car


@settings(max_examples=15, deadline=None)
@given(
    st.integers(1, 60),
    st.floats(0.03, 1.0),
    st.sampled_from([0.0, 0.01, -0.004]),
    st.booleans(),
)
def test_charge_and_where_the_battery_is_empty_are_of_the_road_not_of_the_points(
    parts, charge, slope, learned
):
    """A capacity of energy, or a curved charge whose percents take less the emptier it is."""
    car = drained_car() if learned else "bmw_i3"
    legs = [
        legs_of_trip(np.full(n, 400e3 / n), np.full(n, 16e3 / n), np.full(n, 400e3 / n * slope))
        for n in (1, parts)
    ]
    trips = [planned_energy(plan, car, PlanConditions(charge=charge)) for plan in legs]
    whole, cut = ([trip.empty_at, *trip.charge[:, -1]] for trip in trips)
    assert cut == pytest.approx(whole, rel=1e-9)
    assert 0.0 < whole[0] < 400e3


@settings(max_examples=10, deadline=None)
@given(st.floats(15.0, 40.0), st.floats(0.001, 1.0), st.booleans())
def test_how_far_is_where_the_charge_of_that_very_trip_is_used_up(speed, charge, learned):
    """Also of a short way, whose uneven speed differs from that of a part of a longer one."""
    car, given = drained_car() if learned else "bmw_i3", PlanConditions(charge=charge)
    far = until_empty(speed, car, given)
    assert until_empty(speed, car, given, -1.0) <= far
    if far:
        planned = planned_energy(level_road(speed, far), car, given)
        assert planned.charge[0, -1] == pytest.approx(0.0, abs=1e-6)
        assert planned.empty_at == pytest.approx(far, rel=1e-4)
        used = planned.energies.energy[-1] / planned.gauge.capacity.value
        assert learned or used == pytest.approx(charge, abs=1e-5)
    else:
        assert 0.5 * speed**2 * 1300.0 > 0.8 * charge * 21e3 * 3600.0  # what the speed takes


@settings(max_examples=20, deadline=None)
@given(st.floats(0.001, 1.0), st.lists(st.floats(-0.08, 0.08), min_size=1, max_size=6))
def test_an_empty_battery_reaches_no_descent_and_a_full_one_takes_none_of_it(charge, slopes):
    """One charge in the row, in the node's answer and where it is said to be empty."""
    count = len(slopes)
    climb = 5e3 * np.array(slopes)
    plan = legs_of_trip(np.full(count, 5e3), np.full(count, 300.0), climb)
    planned = planned_energy(plan, "bmw_i3", PlanConditions(charge=charge))
    assert planned.course[0].max() <= 1.0
    assert (planned.empty_at is not None) == (planned.charge[0, -1] <= 0.0)
    start = Uncertain(*planned.charge[:, 0])
    end = BatteryModel(math.nan).after(planned.energies.on_curve, start, planned.gauge.capacity)
    assert end.charge.value == max(planned.charge[0, -1], 0.0)
    curve, capacity = planned.energies.curve, planned.gauge.capacity.value
    if curve.energy.max() < charge * capacity and curve.energy.min() > (charge - 1.0) * capacity:
        assert end.charge.value == pytest.approx(charge - curve.energy[-1] / capacity)


@pytest.mark.parametrize("kmh", [50.0, 90.0, 130.0])
def test_a_full_battery_gives_what_is_used_when_it_is_empty(kmh):
    """The energy when full that the command names is that at which the way ends."""
    legs = legs_of_trip(np.array([600e3]), np.array([600e3 / kmh * 3.6]))
    planned = planned_energy(legs, drained_car(), PlanConditions(charge=1.0))
    curve = planned.energies.curve
    used = np.interp(planned.empty_at, curve.distance, curve.energy)
    assert used == pytest.approx(planned.full.value, rel=0.01)


def test_a_page_tells_a_driver_no_options(tmp_path):
    planned = planned_energy(FEW, "bmw_i3", PlanConditions(charge=0.8))
    assert planned.uneven_part
    write_forecasts(
        tmp_path / "p.html", [PlannedTrip("trip", planned, ())], ["Mild."], "evpinn", METRIC
    )
    body = (tmp_path / "p.html").read_text().partition("<body>")[2]
    assert not re.findall(r"(?<=\s)--?[a-z]\w*", body)


def test_the_charge_on_the_page_ends_at_zero():
    legs = legs_of_trip(np.array([400e3]), np.array([16e3]))
    planned = planned_energy(legs, "bmw_i3", PlanConditions(charge=0.8))
    charge, *_ = _curves(planned, METRIC)
    ticks = [float(text) for text, _ in charge["up"]]
    assert charge["title"].startswith("Charge") and (min(ticks), max(ticks)) == (0.0, 100.0)
    heights = [float(pair.split(",")[1]) for pair in charge["lines"][0].split()]
    assert min(heights) >= 0.0 and max(heights) == 1000.0


def test_the_node_s_battery_at_the_end_is_of_the_road_too():
    """Charge and voltage that it publishes, of a plan with few points and with many."""
    ends = []
    for count in (2, 7, 900):
        time = np.linspace(0.0, 3600.0, count)
        plan = plan_from_speed_profile(time, None, np.linspace(15.0, 35.0, count))
        forecaster = Forecaster(load_vehicle("bmw_i3"))
        battery, charge = drained_car().account.battery, Uncertain(0.9, 0.003)
        answer = forecaster.answer(plan, charge, charge, 0, battery)
        ends.append([*answer.charge, answer.voltage])
    assert ends[1] == pytest.approx(ends[0], rel=1e-9) == ends[2]
    assert 0.05 < ends[0][0] < 0.8 and 300.0 < ends[0][2] < 390.0
