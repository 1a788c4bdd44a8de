"""Baselines find a car that obeys their equations, at any sampling."""

import pytest

from benchmarks.unseen.baselines import BASELINES
from benchmarks.unseen.drives import UnseenCar
from benchmarks.unseen.protocols import run_car
from benchmarks.unseen.summary import summary
from benchmarks.unseen.weak_form import WeakFormLeastSquares

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def scores(car):
    return {name: summary(run_car(car, factory)) for name, factory in BASELINES.items()}


@pytest.mark.parametrize("name", ["weak_ls", "ekf_fast"])
def test_what_was_learned_predicts_the_next_drive(scores, name):
    prior = scores["prior"]["carried"]["gross_mean_percent"]
    assert scores[name]["carried"]["gross_mean_percent"] < min(4.0, prior / 2)


@pytest.mark.parametrize(
    ("seconds", "period", "polled"),
    [(900.0, 0.1, False), (1800.0, 1.2, True), (1800.0, 4.0, False)],
)
def test_weak_form_finds_the_car_at_any_sampling(vehicle, make_drive, seconds, period, polled):
    drives = [
        make_drive(seconds, start=9000.0 * i, period=period, polled=polled) for i in range(3)
    ]
    found = run_car(UnseenCar("made", vehicle, tuple(drives)), WeakFormLeastSquares)
    mass, sigma = found.combinations["mass_over_eta"]
    assert abs(mass / (1950.0 / 0.9) - 1) < 0.05
    assert 0 < sigma < 0.05 * mass
    assert found.combinations["regeneration"][0] == pytest.approx(0.72, rel=0.1)
    assert summary(found)["carried"]["gross_mean_percent"] < 2.0
