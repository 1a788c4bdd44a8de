"""The page of `evpinn forecast --report`, and what its figures are made of."""

from dataclasses import replace

import numpy as np
import pytest

from evpinn_ros.api.plan import planned_energy, what_if
from evpinn_ros.common.units import METRIC
from evpinn_ros.core.energy.forecast import forecast_plan, plan_parts
from evpinn_ros.core.energy.plan import Legs, PlanConditions, legs_of_trip, plan_from_speed_profile
from evpinn_ros.core.energy.power_model import PowerModel
from evpinn_ros.core.estimation.terms import WHOLE, Part
from evpinn_ros.report.forecast_page import _sentence

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
    given = PlanConditions(charge=charge)
    coarse = legs_of_trip(np.array([40e3, 10e3]), np.array([1800.0, 600.0]))
    planned = planned_energy(coarse, "bmw_i3", given)
    energy, distance = planned.energies.energy, planned.trip.distance
    where = float(np.interp(charge * planned.gauge.capacity.value, energy, distance))
    assert 0.0 < where < 40e3 and planned.empty_at == pytest.approx(where)
    assert f"empty after {where / 1e3:.1f} km" in _sentence(planned, METRIC)
    assert planned_energy(coarse, "bmw_i3", PlanConditions(charge=0.0)).empty_at == 0.0
    assert planned_energy(coarse, "bmw_i3", PlanConditions(charge=1.0)).empty_at is None
    assert planned_energy(coarse, "bmw_i3").empty_at is None
