"""Charts of a fleet: what is drawn where, and words for how much."""

import math

import numpy as np
import pytest

from evpinn_ros.common.units import counted, with_sigma
from evpinn_ros.core.estimation.evidence import NO_EVIDENCE, Evidence
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.extras.fleet.page import (
    CHART_TITLES,
    fleet_charts,
    fleet_sentence,
    population_cells,
)
from evpinn_ros.extras.fleet.population import Population

LEAF = load_vehicle("nissan_leaf")


def exact(z: float) -> Evidence:
    """Rolling resistance known exactly, so many sigmas of the prior from it."""
    return Evidence(np.diag([0, 0, 0, 1e8, 0, 0]), np.array([0, 0, 0, 1e8 * z, 0, 0]))


def test_a_car_is_the_vehicle_file_and_its_own_evidence():
    population, prior = Population(LEAF, [exact(1.0)]), LEAF.priors["c_rr"]
    mean, std = population.of_file("c_rr")
    assert (mean, std) == pytest.approx((math.log(prior.value), prior.std / prior.value))
    assert population.of_car("c_rr", NO_EVIDENCE) == (mean, std)
    known, doubt = population.of_car("c_rr", exact(1.0))
    assert known == pytest.approx(mean + std) and doubt < 1e-3 * std
    assert population.of_car("mass_over_eta", exact(1.0)) == population.of_file("mass_over_eta")


def test_rows_lie_in_the_chart_in_their_order():
    cars = {"low": exact(-1.0), "high": exact(1.0)}
    charts = fleet_charts(Population(LEAF, list(cars.values())), cars)
    assert [chart["title"] for chart in charts] == list(CHART_TITLES.values())
    rows = {row.name: row for row in charts[list(CHART_TITLES).index("c_rr")]["rows"]}
    assert list(rows) == ["vehicle file", "low", "high", "next car"]
    assert rows["low"].at < rows["next car"].at < rows["high"].at
    assert all(0.0 <= row.low <= row.at <= row.high <= 100.0 for row in rows.values())


def test_words():
    assert (counted(1, "car"), counted(2, "car")) == ("1 car", "2 cars")
    counts = {"cars": 1, "drives": 1, "learned": 1, "problems": 0}
    assert fleet_sentence(counts) == "1 car, 1 of 1 drive learned, no problem."
    assert with_sigma(2023.4, 231.0) == "2020 ± 230"
    assert with_sigma(0.007482, 0.00117) == "0.0075 ± 0.0012"
    assert with_sigma(3.0, 0.0) == "3 ± 0"


def test_cells_of_a_model_are_numbers_as_people_write_them():
    rows = {name: cells for name, *cells in population_cells(Population(LEAF, [exact(1.0)]))}
    assert not any("e+" in cell or "e-" in cell for cells in rows.values() for cell in cells)
    file, mean, spread, new_car, cars = rows["mass"]
    value, _, sigma = mean.partition(" ± ")
    assert abs(float(value) - float(file.partition(" ± ")[0])) < float(sigma) > 1.0  # kg
    assert spread.endswith(" %") and new_car.startswith("± ") and float(cars) >= 0.0
    assert rows["p_aux"][2].endswith(" W")
