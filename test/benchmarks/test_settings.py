"""Constants are chosen by cars other than the one that is scored, and replaced where they work."""

from collections.abc import Mapping
from dataclasses import replace
import json
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
import pytest
from typer.testing import CliRunner

from benchmarks.cli import settings
from benchmarks.cli.settings import (
    PRODUCT,
    Scores,
    Setting,
    alternatives,
    choose,
    final_variants,
    others,
)
from benchmarks.variants import ConstantPlace, RecordedCar, Variant, VariantRow, read_car, score
from evpinn_ros.cli.main import app

pytestmark = pytest.mark.nightly

BAGS = Path(__file__).parents[2] / "bags"
URBAN, HIGHWAY = (f"{BAGS / name}=tesla_model_3_lr" for name in ("urban", "highway"))
SHORT = 17  # intervals of a drive
ONE = (0,)  # seed
NAMES = [variant.name for variant in alternatives()]
likelihoods = st.fixed_dictionaries({name: st.floats(-9.0, 9.0) for name in NAMES})


@pytest.fixture(scope="module")
def car() -> RecordedCar:
    """Three drives of some minutes in the cold, an outlier, and loads reported for a while."""
    whole = read_car("", URBAN)
    (drive,) = whole.drives
    drive[SHORT // 2] = replace(drive[SHORT // 2], energy=1e6)
    for index, interval in enumerate(drive):
        known = index < SHORT // 4
        here = interval.conditions._replace(celsius=0.0, load=300.0 * known, load_known=known)
        drive[index] = replace(interval, conditions=here)
    return whole._replace(drives=[drive[:SHORT], drive[SHORT:], drive[:SHORT]])


@pytest.fixture(scope="module")
def product(car) -> VariantRow:
    """Scores of the constants as they are."""
    return score(Variant(PRODUCT), car, ONE)


def scores_of(cars: Mapping[str, Mapping[str, float]]) -> Scores:
    row = VariantRow("", "", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return {
        key: {name: replace(row, variant=name, car=key, likelihood=v) for name, v in found.items()}
        for key, found in cars.items()
    }


@given(likelihoods, likelihoods, likelihoods, likelihoods)
def test_the_likelihood_of_a_car_never_enters_the_choice_for_it(own, own_too, one, another):
    judges = {"e208": one, "i3": another}
    before, after = (
        final_variants(scores_of({"leaf2013": mine, **judges}), "leaf2013")
        for mine in (own, own_too)
    )
    assert before[0] == after[0]
    assert before[2].changes == choose(scores_of({"leaf2013": own}), ["leaf2013"])


def test_a_car_under_another_name_does_not_choose_for_it():
    assert others("i3", ["i3", "i3_speed", "e208"]) == ["e208"]
    assert others("sumo_e208", ["e208", "sumo_id3", "simulated"]) == ["e208", "simulated"]


def test_others_choose_what_is_likeliest_for_all_of_them():
    worst = dict.fromkeys(NAMES, 0.0)
    scores = scores_of(
        {
            "e208": worst | {"OUTLIER 4": 1.0, "TURNING.mean 300": 0.1},
            "leaf2013": worst | {"OUTLIER 4": -2.0, "TURNING.mean 300": 0.1},
            "i3": worst | {"OUTLIER 4": 2.0},
            "i3_speed": worst | {"OUTLIER 4": -1.0},  # with the i3 it has one vote, +0.5
        }
    )
    (place,) = choose(scores, list(scores))  # all else ties: the product's
    assert place.name == "TURNING.mean"


@pytest.mark.parametrize("variant", alternatives()[1:], ids=NAMES[1:])
def test_each_alternative_works_and_is_undone(car, product, variant):
    (place,) = variant.changes
    before = place.present
    row = score(variant, car, ONE)
    assert place.present == before
    assert row.likelihood != product.likelihood


def test_the_command_scores_each_car_with_what_the_other_chose(tmp_path, monkeypatch):
    place = ConstantPlace("journey", "NOISE_TIME")
    monkeypatch.setattr(settings, "SETTINGS", (Setting(place, (1.5, 30.0)),))
    file = tmp_path / "found.json"
    command = ["bench", "settings", "", "--cars", f"{URBAN},{HIGHWAY}", "--metrics", str(file)]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    found = json.loads(file.read_text())
    likeliest = {}
    for row in found["alternatives"]:
        best = likeliest.setdefault(row["car"], row)
        likeliest[row["car"]] = max(best, row, key=lambda each: each["likelihood"])
    chosen = {(row["car"], row["variant"]): row["changes"] for row in found["chosen"]}
    for car, other in ((URBAN, HIGHWAY), (HIGHWAY, URBAN)):
        by_other = likeliest[other]["variant"].replace(PRODUCT, "")
        assert chosen[car, settings.UNSEEN] == chosen[other, settings.OWN] == by_other
