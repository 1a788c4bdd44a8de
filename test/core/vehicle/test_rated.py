"""Rated cars: their ratings are in the prior, and certified cars lie within its sigmas."""

import csv
from pathlib import Path

import numpy as np
import pytest

from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.parameters import LIMITS
from evpinn_ros.core.vehicle.rated import (
    BRAKING,
    DRIVING,
    ENERGY_SPREAD,
    FACTORS,
    OPTIMISM,
    PEOPLE,
    cycle_energy,
    rated_cars,
)

CYCLE = Path(__file__).parents[4] / "shared/data/drive_cycles/wltc_3b.csv"
CARS = rated_cars()
CERTIFIED = {  # the same models, of which the road load is certified too
    "audi_e_tron_55_quattro_2020": "audi_e_tron_55_quattro_sportback_2022",
    "bmw_i4_edrive40_2023": "bmw_i4_edrive_40_gran_coupe_18_inch_2022",
    "hyundai_ioniq_5_77_kwh_rwd_2023": "hyundai_ioniq_5_rwd_2022",
    "hyundai_kona_electric_64_kwh_2020": "hyundai_kona_electric_2022",
    "kia_e_niro_64_kwh_2020": "kia_niro_electric_2022",
    "mini_cooper_se_2023": "mini_cooper_se_2022",
    "nissan_leaf_40_kwh_2020": "nissan_leaf_2022",
    "nissan_leaf_e_62_kwh_2020": "nissan_leaf_sv_sl_2022",
    "polestar_2_long_range_single_motor_2023": "polestar_2_single_motor_2022",
    "tesla_model_3_long_range_awd_2024": "tesla_model_3_long_range_awd_2022",
    "tesla_model_3_rwd_2024": "tesla_model_3_rwd_2022",
    "tesla_model_y_long_range_rwd_2024": "tesla_model_y_standard_range_rwd_2022",
    "volkswagen_id_4_pro_77_kwh_2024": "volkswagen_id_4_pro_2022",
}


def values(key: str) -> np.ndarray:
    """Prior values of a vehicle's factors."""
    return np.array([load_vehicle(key).priors[name].value for name in FACTORS])


@pytest.mark.parametrize("key", CARS)
def test_a_rated_car_is_a_vehicle_that_takes_what_it_is_rated_with(key):
    vehicle, car = load_vehicle(key), CARS[key]
    assert (vehicle.key, vehicle.name, vehicle.battery_capacity) == (key, car.name, car.battery)
    for name, prior in vehicle.priors.items():
        limits = LIMITS[name]
        assert limits.lower < prior.value < limits.upper and prior.std > 0 and prior.source
    assert vehicle.initial.mass == pytest.approx(car.curb_mass + PEOPLE, rel=0.05)
    rated = OPTIMISM * car.battery / car.wltp_range
    assert abs(np.log(cycle_energy(values(key)) / rated)) < ENERGY_SPREAD


def test_the_energy_of_the_cycle_is_known_better_than_its_shares():
    vehicle = load_vehicle("peugeot_e_208_50_kwh_2020")
    middle = values(vehicle.key)
    share = np.array([vehicle.priors[name].std for name in FACTORS]) / middle
    covariance = vehicle.correlation[:5, :5] * np.outer(share, share)
    step = 1e-4
    moved = middle * (1.0 + step * np.eye(5))
    row = np.array(
        [np.log(cycle_energy(changed) / cycle_energy(middle)) / step for changed in moved]
    )
    whole = np.sqrt(row @ covariance @ row)
    assert whole < ENERGY_SPREAD and whole < 0.75 * np.sqrt(row**2 @ share**2)


def test_certified_road_loads_lie_where_the_ratings_say():
    """In sigmas of mass, c_rr and c_d; fitted to these 13 models was the energy alone."""
    names = ("mass", "c_rr", "c_d")
    away = []
    for rated, certified in CERTIFIED.items():
        prior, true = load_vehicle(rated).priors, load_vehicle(certified).priors
        away.append([(true[n].value - prior[n].value) / prior[n].std for n in names])
    rms = np.sqrt(np.mean(np.square(away), axis=0))
    assert (rms < 1.2).all() and (rms > 0.4).all()


@pytest.mark.parametrize("measured", ["ioniq 5 rwd", "kona electric", "leaf sv sl"])
def test_words_mean_a_certified_car_before_a_rated_one(measured):
    assert load_vehicle(measured).key not in CARS


@pytest.mark.skipif(not CYCLE.is_file(), reason="the cycle itself is not here")
def test_the_sums_of_the_cycle_are_those_of_the_cycle():
    with CYCLE.open(encoding="utf-8-sig") as file:
        speed = np.array([float(row["cycMps"]) for row in csv.DictReader(file)])
    middle, gained = (speed[1:] + speed[:-1]) / 2, np.diff(speed)
    force = 0.0085 * 9.81 * 1900 * (middle > 0) + 0.6 * 0.68 * middle**2 + 1.03 * 1900 * gained
    for part, sums in ((force > 0, DRIVING), (force <= 0, BRAKING)):
        way = middle[part]
        shares = np.array([way.sum(), (way**3).sum(), (way * gained[part]).sum()]) / middle.sum()
        np.testing.assert_allclose(shares, sums, rtol=0.002)
