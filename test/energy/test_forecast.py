import dataclasses
import math
import time as clock

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.energy.charge import UNKNOWN, Uncertain
from evpinn_ros.energy.forecast import (
    DIRECTION_LENGTH,
    battery_after,
    difference,
    forecast_plan,
)
from evpinn_ros.energy.plan import Plan, plan_from_path, plan_from_speed_profile
from evpinn_ros.energy.power_model import PlanEnd, PowerModel, combined_model, vehicle_model
from evpinn_ros.vehicle.files import load_vehicle
from evpinn_ros.vehicle.identifiable import IDENTIFIABLE_NAMES, Identifiable, combined_power
from evpinn_ros.vehicle.physics import GRAVITY

CAR = load_vehicle("tesla_model_3_lr")
COMBINED = Identifiable(2200.0, 0.65, 0.0096, 0.6, 1100.0)
EXACT = Identifiable(0.0, 0.0, 0.0, 0.0, 0.0)
SIGMAS = Identifiable(20.0, 0.05, 0.0005, 0.03, 100.0)


def forecast(plan, combined, sigmas, residual_sigma, density=CAR.air_density):
    return forecast_plan(plan, combined_model(combined, sigmas, CAR, residual_sigma), density)


def energy(plan, combined=COMBINED):
    return forecast(plan, combined, EXACT, 0.0).energy[-1]


def cruise(speed, duration, climb=0.0, points=5):
    t = np.linspace(0, duration, points)
    return plan_from_speed_profile(
        t, speed * t, np.full(points, speed), np.linspace(0, climb, points)
    )


def stop_to_stop(speeds):
    """A flat trip, 10 s a leg, from rest to rest."""
    v = np.array([0.0, *speeds, 0.0])
    t = 10.0 * np.arange(len(v))
    s = np.concatenate(([0.0], np.cumsum((v[1:] + v[:-1]) / 2 * 10)))
    return plan_from_speed_profile(t, s, v)


speed_lists = st.lists(st.floats(0, 35), min_size=1, max_size=12)


def test_cruising_by_hand():
    drag = 0.5 * CAR.air_density * 0.65 * 20.0**2
    rolling = 0.0096 * 2200 * GRAVITY
    power = 20.0 * (drag + rolling) + 1100
    result = forecast(cruise(20.0, 100.0), COMBINED, EXACT, 0.0)
    assert result.power == pytest.approx([power] * 5)
    assert result.energy == pytest.approx(power * np.linspace(0, 100, 5))
    assert result.sigma == pytest.approx([0.0] * 5)


@given(st.floats(0.1, 1e5), st.integers(2, 9))
def test_standing_costs_auxiliary_power(duration, points):
    plan = cruise(0.0, duration, points=points)
    assert energy(plan) == pytest.approx(1100.0 * duration)


def test_kinetic_and_potential_energy_are_exact():
    frictionless = Identifiable(2000.0, 0.0, 0.0, 1.0, 0.0)
    plan = plan_from_speed_profile([0.0, 20.0], [0.0, 300.0], [10.0, 22.0], [0.0, 12.0])
    kinetic = CAR.rotating_mass_factor * 2000 * (22.0**2 - 10.0**2) / 2
    assert energy(plan, frictionless) == pytest.approx(kinetic + 2000 * GRAVITY * 12, rel=1e-12)


def test_against_fine_integration():
    plan = stop_to_stop([12.0, 16.0, 9.0, 27.0, 30.0, 11.0])
    t = np.arange(0, plan.time[-1], 0.001)
    a = np.diff(plan.speed)[np.minimum(t // 10, 6).astype(int)] / 10
    power = combined_power(
        np.interp(t, plan.time, plan.speed),
        a,
        COMBINED,
        air_density=CAR.air_density,
        rotating_mass_factor=CAR.rotating_mass_factor,
    )
    assert energy(plan) == pytest.approx(power.sum() * 0.001, rel=2e-3)


@given(st.floats(1, 40), st.floats(0, 0.15))
def test_hills_never_save_energy(speed, grade):
    duration = 100.0
    climb = speed * duration * math.sin(grade)
    hilly = energy(cruise(speed, duration, climb)) + energy(cruise(speed, duration, -climb))
    # On a slope the car presses on the road less by cos(grade), so it rolls that much easier.
    rolling = 2 * 0.0096 * 2200 * GRAVITY * speed * duration * (1 - math.cos(grade))
    assert hilly - 2 * energy(cruise(speed, duration)) >= -rolling - 1e-6


@given(speed_lists, st.sampled_from(["mass_over_eta", "drag_area_over_eta", "c_rr", "p_aux"]))
def test_more_of_anything_is_never_cheaper(speeds, name):
    plan = stop_to_stop(speeds)
    more = COMBINED._replace(**{name: 1.2 * getattr(COMBINED, name)})
    assert energy(plan, more) >= energy(plan) - 1e-6


@given(speed_lists)
def test_better_regeneration_is_never_dearer(speeds):
    plan = stop_to_stop(speeds)
    assert energy(plan, COMBINED._replace(regeneration=0.8)) <= energy(plan) + 1e-6


@given(speed_lists, st.data())
def test_a_plan_cut_in_two_adds_up(speeds, data):
    plan = stop_to_stop(speeds)
    cut = data.draw(st.integers(1, len(plan.time) - 2))
    arrays = (plan.time, plan.distance, plan.speed, plan.elevation)
    first = Plan(*(array[: cut + 1] for array in arrays))
    second = Plan(*(array[cut:] for array in arrays))
    assert energy(first) + energy(second) == pytest.approx(energy(plan), rel=1e-12)


@given(st.lists(speed_lists.filter(lambda v: len(v) == 3), min_size=1, max_size=4))
def test_a_batch_is_its_trips(trips):
    plans = [stop_to_stop(speeds) for speeds in trips]
    names = ("time", "distance", "speed", "elevation")
    batch = Plan(*(np.stack([getattr(plan, name) for plan in plans]) for name in names))
    together = forecast(batch, COMBINED, SIGMAS, 800.0)
    for i, plan in enumerate(plans):
        alone = forecast(plan, COMBINED, SIGMAS, 800.0)
        for name in ("time", "energy", "power", "sigma"):
            assert getattr(together, name)[i] == pytest.approx(getattr(alone, name), rel=1e-9)


@pytest.mark.parametrize("name", IDENTIFIABLE_NAMES)
def test_sigma_of_one_combination_against_sampling(name):
    plan = stop_to_stop([10.0, 15.0, 15.0, 5.0, 20.0])
    sigma = EXACT._replace(**{name: getattr(SIGMAS, name)})
    random = np.random.default_rng(7)
    value = getattr(COMBINED, name)
    drawn = value + getattr(SIGMAS, name) * random.normal(size=500)
    energies = [energy(plan, COMBINED._replace(**{name: sample})) for sample in drawn]
    result = forecast(plan, COMBINED, sigma, 0.0)
    assert result.sigma[-1] == pytest.approx(np.std(energies), rel=0.1)


def test_parts_of_sigma_add_as_variances():
    plan = cruise(15.0, 300.0)
    parts = [forecast(plan, COMBINED, EXACT, 900.0).sigma]
    for name in IDENTIFIABLE_NAMES:
        only = EXACT._replace(**{name: getattr(SIGMAS, name)})
        parts.append(forecast(plan, COMBINED, only, 0.0).sigma)
    whole = forecast(plan, COMBINED, SIGMAS, 900.0).sigma
    assert whole == pytest.approx(np.sqrt(np.square(parts).sum(axis=0)))
    assert (np.diff(whole) > 0).all()
    assert parts[IDENTIFIABLE_NAMES.index("p_aux") + 1][-1] == pytest.approx(100.0 * 300)


def test_cold_air_costs_more():
    plan = cruise(30.0, 100.0)
    cold = forecast(plan, COMBINED, EXACT, 0.0, 1.35).energy[-1]
    assert cold > energy(plan)


def test_contradicting_speeds_stay_finite():
    plan = Plan(*np.array([[0.0, 10.0], [0.0, 1.0], [30.0, 30.0], [0.0, 0.0]]))
    assert math.isfinite(energy(plan))


def test_ten_thousand_points_are_quick():
    x = np.linspace(0, 100e3, 10_000)
    z = 50 * np.sin(x / 3000)
    start = clock.perf_counter()
    result = forecast(plan_from_path(x, 0 * x, z), COMBINED, SIGMAS, 800.0)
    assert clock.perf_counter() - start < 2.0
    assert 100e3 * 300 < result.energy[-1] < 100e3 * 900  # J over 100 km


@given(st.floats(2, 40), st.floats(1.1, 4))
def test_the_same_way_more_slowly(speed, slower):
    """Rolling costs as before, drag less by the square of speed, auxiliaries more by the time."""
    length = 3000.0
    quick, slow = cruise(speed, length / speed), cruise(speed / slower, length * slower / speed)
    _, area, c_rr, _, p_aux = COMBINED
    rolling = 2200.0 * c_rr * GRAVITY * length
    drag = 0.5 * CAR.air_density * area * speed**2 * length
    assert energy(quick) == pytest.approx(rolling + drag + p_aux * length / speed)
    standing = p_aux * length * slower / speed
    assert energy(slow) == pytest.approx(rolling + drag / slower**2 + standing)


def test_wind_against_the_car_counts_less_the_farther_it_goes():
    speed, wind = 20.0, 6.0
    model, plan = combined_model(COMBINED, EXACT, CAR, 0.0), cruise(speed, 2000.0, points=2001)
    calm, windy, tail = (
        forecast_plan(plan, model, CAR.air_density, against) for against in (0.0, wind, -wind)
    )
    drag = 0.5 * CAR.air_density * COMBINED.drag_area_over_eta * speed
    assert windy.power[0] - calm.power[0] == pytest.approx(drag * ((speed + wind) ** 2 - speed**2))
    more = windy.energy[-1] - calm.energy[-1]
    along = np.exp(-plan.distance / DIRECTION_LENGTH)
    added = drag / speed * ((speed + wind * along) ** 2 - speed**2)
    assert more == pytest.approx(np.trapezoid(added, plan.distance), rel=0.01)
    assert -more < tail.energy[-1] - calm.energy[-1] < 0
    many = Plan(*(np.stack([getattr(plan, name)] * 2) for name in Plan.__slots__))
    both = forecast_plan(many, model, CAR.air_density, wind)
    assert both.energy[:, -1] == pytest.approx(windy.energy[-1])


def test_battery_after():
    result = forecast(cruise(20.0, 100.0), COMBINED, SIGMAS, 0.0)
    used, sigma = result.energy[-1], result.sigma[-1]
    full = Uncertain(10 * used, used)  # 10 %
    after = battery_after(result, Uncertain(0.5, 0.003), full)
    assert after.value == pytest.approx(0.4)
    assert after.sigma == pytest.approx(math.hypot(0.003, sigma / full.value, 0.1 * 0.1))
    assert battery_after(result, Uncertain(0.05, 0.003), full).value == 0.0
    assert not battery_after(result, UNKNOWN, full).known
    assert not battery_after(result, Uncertain(0.5, 0.003), UNKNOWN).known


def test_the_sigma_of_a_difference_is_what_drawing_cars_gives():
    """Coefficients are drawn for both plans at once: what both share cancels in the difference."""
    model = vehicle_model(CAR, 0.0)
    time = np.arange(0.0, 300.0, 5.0)
    plans = [
        plan_from_speed_profile(time, speed * time, np.full(time.size, speed))
        for speed in (15.0, 17.0)
    ]
    one, other = (forecast_plan(plan, model, 1.2) for plan in plans)
    drawn = np.random.default_rng(1).normal(size=(20_000, len(model.linear.directions)))
    energies = [found.end.energies[0] + drawn @ found.end.energies[1:] for found in (one, other)]
    found = difference(model, one.end, other.end)
    assert found.value == pytest.approx(one.energy[-1] - other.energy[-1])
    assert found.sigma == pytest.approx(np.std(energies[0] - energies[1]), rel=0.03)
    assert found.sigma < 0.5 * one.sigma[-1]
    assert one.sigma[-1] == pytest.approx(np.std(energies[0]), rel=0.03)


def test_the_drift_of_auxiliary_power_cancels_while_both_last():
    """Against paths of the drift itself, drawn step by step."""
    linear = dataclasses.replace(vehicle_model(CAR, 0.0).linear, drift_std=500.0, drift_time=120.0)
    model = PowerModel(linear)
    zero = np.zeros(1 + len(linear.directions))
    one, other = (PlanEnd(zero, t, 1000.0, 100.0) for t in (100.0, 400.0))
    step, rng = 1.0, np.random.default_rng(2)
    keep = math.exp(-step / 120.0)
    drift, total = np.zeros(20_000), np.zeros(20_000)
    for second in range(400):
        total += drift * step if second >= 100 else 0.0
        drift = keep * drift + 500.0 * math.sqrt(1 - keep**2) * rng.normal(size=drift.size)
    assert difference(model, one, other).sigma == pytest.approx(np.std(total), rel=0.03)
    assert difference(model, one, one).sigma == 0.0
