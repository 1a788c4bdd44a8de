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
from benchmarks.variants import ConstantPlace, VariantRow
from evpinn_ros.cli.main import app

pytestmark = pytest.mark.nightly

BAGS = Path(__file__).parents[2] / "bags"
URBAN, HIGHWAY = (f"{BAGS / name}=tesla_model_3_lr" for name in ("urban", "highway"))
SHORT = 17  # intervals of a drive
ONE = (0,)  # seed
NAMES = [variant.name for variant in alternatives()]
likelihoods = st.fixed_dictionaries({name: st.floats(-9.0, 9.0) for name in NAMES})


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
