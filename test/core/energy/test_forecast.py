import dataclasses
import math
from statistics import NormalDist

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.battery_model import BatteryModel
from evpinn_ros.core.energy.charge import UNKNOWN, Uncertain
from evpinn_ros.core.energy.course import WIND_STEPS
from evpinn_ros.core.energy.forecast import DIRECTION_LENGTH, forecast_plan
from evpinn_ros.core.energy.plan import COLUMNS, Plan, plan_from_speed_profile
from evpinn_ros.core.energy.power_model import PowerModel, Weather, vehicle_model
from evpinn_ros.core.estimation.journey import LOAD_TIME
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.identifiable import (
    IDENTIFIABLE_NAMES,
    Identifiable,
    prior_identifiable,
)
from evpinn_ros.core.vehicle.physics import GRAVITY
from test.combined import combined_power
from test.core.energy.cars import CAR, COMBINED, EXACT, FEW, SIGMAS, plain

STEP = 2.0  # s of a leg; a plan of coarser ones has uneven speed
AIR = Weather(CAR.air_density)


def forecast(plan, combined=COMBINED, sigmas=EXACT, density=CAR.air_density):
    return forecast_plan(plan, plain(combined, sigmas), Weather(density), steady=True)


def energy(plan, combined=COMBINED):
    return forecast(plan, combined).energy[-1]


def cruise(speed, duration, climb=0.0, points=None):
    points = points or 1 + math.ceil(duration / STEP)
    t = np.linspace(0, duration, points)
    return plan_from_speed_profile(
        t, speed * t, np.full(points, speed), np.linspace(0, climb, points)
    )


def stop_to_stop(speeds):
    """A flat trip, 10 s from speed to speed, from rest to rest."""
    count = round(10.0 / STEP)
    corners = np.array([0.0, *speeds, 0.0])
    v = np.interp(np.arange(count * (len(corners) - 1) + 1) / count, range(len(corners)), corners)
    t = STEP * np.arange(len(v))
    s = np.concatenate(([0.0], np.cumsum((v[1:] + v[:-1]) / 2 * STEP)))
    return plan_from_speed_profile(t, s, v)


speed_lists = st.lists(st.floats(0, 35), min_size=1, max_size=12)


def test_cruising_by_hand():
    drag = 0.5 * CAR.air_density * 0.65 * 20.0**2
    rolling = 0.0096 * 2200 * GRAVITY
    power = 20.0 * (drag + rolling) + 1100
    result = forecast(cruise(20.0, 100.0))
    assert result.power == pytest.approx([power] * 51)
    assert result.energy == pytest.approx(power * np.linspace(0, 100, 51))
    assert result.sigma == pytest.approx([0.0] * 51)


@FEW
@given(st.floats(0.1, 1e5), st.integers(2, 9))
def test_standing_costs_auxiliary_power(duration, points):
    """Standing has no uneven speed, however far apart its points are."""
    plan = cruise(0.0, duration, points=points)
    assert energy(plan) == pytest.approx(1100.0 * duration)


def test_kinetic_and_potential_energy_are_exact():
    frictionless = Identifiable(2000.0, 0.0, 0.0, 1.0, 0.0)
    plan = plan_from_speed_profile([0.0, 4.0], [0.0, 64.0], [10.0, 22.0], [0.0, 3.0])
    kinetic = CAR.rotating_mass_factor * 2000 * (22.0**2 - 10.0**2) / 2
    assert energy(plan, frictionless) == pytest.approx(kinetic + 2000 * GRAVITY * 3, rel=1e-12)


def test_against_fine_integration():
    """The equation is linear about the prior car, whose energies these are."""
    prior, _ = prior_identifiable(CAR)
    plan = stop_to_stop([12.0, 16.0, 9.0, 27.0, 30.0, 11.0])
    t = np.arange(0, plan.time[-1], 0.001)
    legs = np.diff(plan.speed) / STEP
    a = legs[np.minimum(t // STEP, len(legs) - 1).astype(int)]
    power = combined_power(
        np.interp(t, plan.time, plan.speed),
        a,
        prior,
        air_density=CAR.air_density,
        rotating_mass_factor=CAR.rotating_mass_factor,
    )
    assert energy(plan, prior) == pytest.approx(power.sum() * 0.001, rel=2e-3)


@FEW
@given(st.floats(1, 40), st.floats(0, 0.15))
def test_hills_never_save_energy(speed, grade):
    """For the prior car, which decides in the equation where a car drives and where it brakes."""
    prior, _ = prior_identifiable(CAR)
    duration = 100.0
    climb = speed * duration * math.sin(grade)
    up, down = (energy(cruise(speed, duration, rise), prior) for rise in (climb, -climb))
    assert up + down - 2 * energy(cruise(speed, duration), prior) >= -1e-6 * abs(up + down)


@FEW
@given(speed_lists, st.data())
def test_a_plan_cut_in_two_adds_up(speeds, data):
    plan = stop_to_stop(speeds)
    cut = data.draw(st.integers(1, len(plan.time) - 2))
    arrays = (plan.time, plan.distance, plan.speed, plan.elevation)
    first = Plan(*(array[: cut + 1] for array in arrays))
    second = Plan(*(array[cut:] for array in arrays))
    assert energy(first) + energy(second) == pytest.approx(energy(plan), rel=1e-12)


@FEW
@given(st.lists(speed_lists.filter(lambda v: len(v) == 3), min_size=1, max_size=4))
def test_a_batch_is_its_trips(trips):
    plans = [stop_to_stop(speeds) for speeds in trips]
    names = ("time", "distance", "speed", "elevation")
    batch = Plan(*(np.stack([getattr(plan, name) for plan in plans]) for name in names))
    together = forecast(batch, COMBINED, SIGMAS)
    for i, plan in enumerate(plans):
        alone = forecast(plan, COMBINED, SIGMAS)
        for name in ("time", "energy", "power", "sigma"):
            assert getattr(together, name)[i] == pytest.approx(getattr(alone, name), rel=1e-9)


@pytest.mark.parametrize("name", IDENTIFIABLE_NAMES)
def test_sigma_of_one_combination_against_sampling(name):
    plan = stop_to_stop([10.0, 15.0, 15.0, 5.0, 20.0])
    sigma = EXACT._replace(**{name: getattr(SIGMAS, name)})
    value, normal, count = getattr(COMBINED, name), NormalDist(), 60
    drawn = [value + getattr(SIGMAS, name) * normal.inv_cdf((i + 0.5) / count)
             for i in range(count)]  # fmt: skip
    energies = [energy(plan, COMBINED._replace(**{name: sample})) for sample in drawn]
    result = forecast(plan, COMBINED, sigma)
    assert result.sigma[-1] == pytest.approx(np.std(energies), rel=0.1)


def test_wind_that_was_measured_counts_less_the_farther_the_car_goes():
    speed, wind = 20.0, 6.0
    model, plan = plain(), cruise(speed, 2000.0, points=2001)
    calm, windy, tail = (
        forecast_plan(plan, model, AIR, against, DIRECTION_LENGTH, steady=True)
        for against in (0.0, wind, -wind)
    )
    drag = 0.5 * CAR.air_density * COMBINED.drag_area_over_eta * speed
    step = wind * math.exp(-0.5 / WIND_STEPS)  # in the middle of the first step
    first = drag * ((speed + step) ** 2 - speed**2)
    assert windy.power[0] - calm.power[0] == pytest.approx(first, rel=3e-3)
    more = windy.energy[-1] - calm.energy[-1]
    along = np.exp(-plan.distance / DIRECTION_LENGTH)
    added = drag / speed * ((speed + wind * along) ** 2 - speed**2)
    assert more == pytest.approx(np.trapezoid(added, plan.distance), rel=0.01)
    assert -more < tail.energy[-1] - calm.energy[-1] < 0
    many = Plan(*(np.stack([getattr(plan, name)] * 2) for name in COLUMNS))
    both = forecast_plan(many, model, AIR, wind, DIRECTION_LENGTH, steady=True)
    assert both.energy[:, -1] == pytest.approx(windy.energy[-1])


@pytest.mark.parametrize("name", ["bmw_i3", "tesla_model_3_lr", "generic"])
@pytest.mark.parametrize("top", [8.0, 20.0, 28.0])
def test_speeds_that_are_commanded_take_as_much_however_few_points_have_them(name, top):
    """README's plan of four points, and the same motion once a second or in ten."""
    model = vehicle_model(load_vehicle(name))
    knots = np.array([0.0, 15.0, 400.0, 420.0])

    def plan(time: np.ndarray) -> Plan:
        speed = np.interp(time, knots, [0.0, top, top, 0.0])
        length = plan_from_speed_profile(time, None, speed).distance
        return plan_from_speed_profile(time, None, speed, 50.0 * length / length[-1])

    few, some = plan(knots), plan(np.unique(np.append(knots, np.arange(0.0, 421.0, 10.0))))
    dense = forecast_plan(plan(np.arange(421.0)), model, AIR, steady=True)
    for cut in (few, some):
        commanded = forecast_plan(cut, model, AIR, steady=True)
        same = forecast_plan(dataclasses.replace(cut, commanded=True), model, AIR, along=False)
        assert commanded.energy == pytest.approx(same.energy, rel=1e-9)
        assert commanded.time.tolist() == cut.time.tolist()
        at = np.searchsorted(dense.time, cut.time)
        assert commanded.energy == pytest.approx(dense.energy[at], rel=0.01)
        assert commanded.sigma[1:] == pytest.approx(dense.sigma[at][1:], rel=0.05)
        assert forecast_plan(cut, model, AIR).energy[-1] > commanded.energy[-1]


def test_a_forecast_of_the_end_alone_is_that_of_the_whole_way():
    car = vehicle_model(CAR).car
    mean = car.mean + 0.5 * np.sqrt(np.diag(car.covariance))
    mean[State.LOAD] = 300.0  # which fades within minutes
    model, plan = PowerModel(dataclasses.replace(car, mean=mean)), cruise(20.0, 2000.0, 1500)
    whole, end = (forecast_plan(plan, model, AIR, 5.0, along=along) for along in (True, False))
    np.testing.assert_allclose(end.energy, whole.energy, rtol=1e-9)
    np.testing.assert_allclose(end.power, whole.power, rtol=1e-9)
    assert np.isnan(end.sigma[1:-1]).all() and end.sigma[-1] == pytest.approx(whole.sigma[-1])
    np.testing.assert_allclose(end.end.row, whole.end.row, rtol=1e-9, atol=1e-6)
    assert end.end[1:] == whole.end[1:]


def test_without_a_model_of_the_battery_its_charge_is_energy_over_capacity():
    battery = BatteryModel(math.nan)
    result = forecast(cruise(20.0, 100.0), COMBINED, SIGMAS)
    used, sigma = result.energy[-1], result.sigma[-1]
    full = Uncertain(10 * used, used)  # 10 %
    after, voltage = battery.after(result, Uncertain(0.5, 0.003), full)
    assert math.isnan(voltage)
    assert after.value == pytest.approx(0.4)
    assert after.sigma == pytest.approx(math.hypot(0.003, sigma / full.value, 0.1 * 0.1))
    assert battery.after(result, Uncertain(0.05, 0.003), full).charge.value == 0.0
    assert not battery.after(result, UNKNOWN, full).charge.known
    assert not battery.after(result, Uncertain(0.5, 0.003), UNKNOWN).charge.known


def test_the_sigma_of_a_difference_is_what_drawing_cars_gives():
    """States are drawn for both plans at once: what both share cancels in the difference."""
    car = vehicle_model(CAR).car
    quiet = {"load_variance": 0.0, "growth": 0.0, "noise": np.zeros(3), "trust": 1.0}
    model = PowerModel(dataclasses.replace(car, **quiet))
    time = np.arange(0.0, 300.0, 5.0)
    plans = [
        plan_from_speed_profile(time, speed * time, np.full(time.size, speed))
        for speed in (15.0, 17.0)
    ]
    slow, fast = (forecast_plan(plan, model, AIR, steady=True) for plan in plans)
    rng = np.random.default_rng(1)
    drawn = rng.multivariate_normal(car.mean, car.covariance, 20_000, method="eigh")
    energies = [drawn @ trip.end.row for trip in (slow, fast)]
    difference = model.difference(slow.end, fast.end)
    assert difference.value == pytest.approx(slow.energy[-1] - fast.energy[-1])
    assert difference.sigma == pytest.approx(np.std(energies[0] - energies[1]), rel=0.03)
    assert difference.sigma < 0.5 * slow.sigma[-1]
    assert slow.sigma[-1] == pytest.approx(np.std(energies[0]), rel=0.03)


def test_the_wandering_load_cancels_while_both_last():
    """Against paths of the load itself, drawn step by step."""
    car = dataclasses.replace(plain().car, load_variance=500.0**2)
    model = PowerModel(car)
    short, long = (forecast_plan(cruise(0.0, t), model, AIR) for t in (100.0, 400.0))
    rng, keep = np.random.default_rng(2), math.exp(-1.0 / LOAD_TIME)
    load, total = np.zeros(20_000), np.zeros(20_000)
    for second in range(400):
        total += load if second >= 100 else 0.0
        load = keep * load + 500.0 * math.sqrt(1 - keep**2) * rng.normal(size=load.size)
    assert model.difference(short.end, long.end).sigma == pytest.approx(np.std(total), rel=0.03)
    assert model.difference(short.end, short.end).sigma == 0.0
