"""Certified cars: their table, what is made of it, and how they are found."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.vehicle.certified import (
    AIR_DENSITY,
    COASTDOWN_SPEEDS,
    DRAG_SPREAD,
    MASS_SPREAD,
    ROLLING_SPREAD,
    certified_cars,
)
from evpinn_ros.core.vehicle.files import find_vehicles, known_vehicles, load_vehicle
from evpinn_ros.core.vehicle.parameters import LIMITS
from evpinn_ros.core.vehicle.physics import drag_force, rolling_force

LIST = Path(__file__).parents[4] / "shared/data/epa_road_load/electric_2022.csv"
CARS = certified_cars()
ANY_MASS = (1300.0, 3200.0)  # kg, with people, within 2 sigma: of a small car, of a large one


@pytest.mark.skipif(not LIST.is_file(), reason="the list itself is not here")
def test_the_table_is_the_list():
    """Every road load and test mass, and the energies of the two cycles, by the list's units."""
    energies = {}
    with LIST.open() as file:
        for row in csv.DictReader(file):
            names = ("test_mass_kg", "a_n", "b_n_per_mps", "c_n_per_mps2")
            load = tuple(float(row[name]) for name in names)
            cycles = energies.setdefault(load, {"UDDS": [], "Highway": []})
            kind = row["procedure"].removeprefix("Charge Depleting ")
            if kind in cycles and row["economy"]:
                stated = float(row["economy"])
                kwh_per_100_miles = stated if stated < 50 else 3370.5 / stated
                cycles[kind].append(kwh_per_100_miles * 1000 / 160.9344)
    assert {tuple(load) for car in CARS.values() for load in car.loads} == energies.keys()
    for car in CARS.values():
        if len(car.loads) == 1:
            udds = energies[tuple(car.loads[0])]["UDDS"]
            assert not udds or min(udds) - 0.1 < car.udds < max(udds) + 0.1, car.name


@pytest.mark.parametrize("key", CARS)
def test_every_certified_car_is_a_vehicle(key):
    vehicle = load_vehicle(key)
    assert vehicle.key == key and vehicle.name == CARS[key].name
    for name, prior in vehicle.priors.items():
        limits = LIMITS[name]
        assert limits.lower < prior.value < limits.upper and prior.std > 0 and prior.source
    start = vehicle.initial
    rolls = rolling_force(start.mass, start.c_rr)
    drags = drag_force(COASTDOWN_SPEEDS, start.c_d * vehicle.frontal_area, AIR_DENSITY)
    certified = np.mean([load.force(COASTDOWN_SPEEDS) for load in CARS[key].loads], axis=0)
    off = (rolls + drags) / certified - 1.0
    assert np.sqrt(np.mean(off**2)) < 0.045
    assert rolls + drags == pytest.approx(certified, rel=0.13)


def population(cars):
    """Prior of a car that is not known: logarithms of mass, kg, c_rr and drag area, m^2.

    Certified cars are sold in the United States and heavy; small cars weigh half of them. So mass
    is as `ANY_MASS`, and of the certified cars is taken what belongs to a mass: how c_rr and drag
    area go with it, and how they spread at one mass.

    Returns:
        Mean, shape (3,), and covariance, shape (3, 3).
    """
    logs = np.array([np.log([load.physics for load in car.loads]).mean(axis=0) for car in cars])
    mean, covariance = logs.mean(axis=0), np.cov(logs.T)
    slope = covariance[0] / covariance[0, 0]  # of each on mass; of mass itself 1
    low, high = np.log(ANY_MASS)
    centre, variance = (low + high) / 2, ((high - low) / 4) ** 2
    wide = covariance + np.outer(slope, slope) * (variance - covariance[0, 0])
    own = np.square((MASS_SPREAD, ROLLING_SPREAD, DRAG_SPREAD))
    return mean + slope * (centre - mean[0]), wide + np.diag(own)


def test_generic_is_the_population():
    """So that the file holds the priors, and this test why."""
    generic, (mean, covariance) = load_vehicle("generic"), population(CARS.values())
    start, sigma = generic.initial, np.sqrt(covariance.diagonal())
    priors = [start.mass, start.c_rr, start.c_d * generic.frontal_area]
    assert priors == pytest.approx(np.exp(mean), rel=0.01)
    shares = [prior.std / prior.value for prior in generic.priors.values()][2:5]
    assert shares == pytest.approx(sigma, rel=0.02)
    correlation = covariance / np.outer(sigma, sigma)
    assert generic.correlation[2:5, 2:5] == pytest.approx(correlation, abs=0.03)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("model 3 long range", "tesla_model_3_lr"),  # but for the make
        ("Model 3 (long range) AWD", "tesla_model_3_long_range_awd_2022"),
        ("ioniq 5 rwd", "hyundai_ioniq_5_rwd_2022"),
        ("ID.4 Pro S 2022", "volkswagen_id_4_pro_s_2022"),
        ("i4 m50 20 inch", "bmw_i4_m50_gran_coupe_20_inch_2022"),
        ("Leaf", "nissan_leaf"),
    ],
)
def test_a_car_by_words_of_its_name(text, key):
    if text.startswith("ID.4"):  # two have these words: the AWD one, and this, whose name they are
        assert len(find_vehicles(text)) == 2
    assert load_vehicle(text).key == key


def test_names_of_several_cars_and_of_none():
    with pytest.raises(InputError, match=r"several vehicles match 'model 3': .*performance_awd"):
        load_vehicle("model 3")
    # One car has a short name; its make alone names no car of the eight.
    with pytest.raises(InputError, match=r"several vehicles match 'bmw': .*bmw_i3, bmw_i4"):
        load_vehicle("bmw")
    with pytest.raises(InputError, match="did you mean porsche_taycan_turbo_2022"):
        load_vehicle("porsche taican turbo 2022")
    assert find_vehicles().keys() == {*known_vehicles()}
    assert find_vehicles("zeppelin") == {}
    e_208 = find_vehicles("e-208")
    assert len(e_208) == 2
    assert all(find_vehicles(text) == e_208 for text in ("e208", "E 208", "peugeot E208"))


def test_a_battery_that_another_car_of_ours_has_is_known():
    """Of a third of the certified cars; these weigh about as much, and get about as far."""
    packs = {key: car.pack_of for key, car in CARS.items() if car.pack_of}
    assert len(packs) > len(CARS) / 4
    for key, other in packs.items():
        car, same = load_vehicle(key), load_vehicle(other)
        assert car.battery_capacity == same.battery_capacity > 20 * 3.6e6
        assert car.priors["mass"].value == pytest.approx(same.priors["mass"].value, rel=0.25)
    assert math.isnan(load_vehicle("nissan_leaf_2022").battery_capacity)  # 40 or 62 kWh
