"""Every part of the core can be left out, is missed by something, and is back afterwards."""

from dataclasses import replace
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import variants
from benchmarks.cli.ablation import VARIANTS
from benchmarks.variants import RecordedCar, VariantRow, read_car, score
from evpinn_ros.cli.main import app

pytestmark = pytest.mark.nightly

URBAN = f"{Path(__file__).parents[2] / 'bags' / 'urban'}=tesla_model_3_lr"
CUT = 20  # interval that begins another drive


@pytest.fixture(scope="module")
def car() -> RecordedCar:
    """Three drives of few minutes in the cold, an outlier, no height, and reported loads."""
    whole = read_car("", URBAN)
    (drive,) = whole.drives
    drive[3] = replace(drive[3], energy=1e6)
    for index, interval in enumerate(drive):
        here = interval.conditions._replace(celsius=0.0, load=400.0, load_known=index % 2 == 0)
        drive[index] = replace(interval, conditions=here, height_known=False)
    return whole._replace(drives=[drive[:CUT], drive[CUT:], drive[:CUT]])


@pytest.fixture(scope="module", autouse=True)
def short_stretches():
    """Stretches within drives as short as these."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(variants, "FIRST", 100.0)
        patch.setattr(variants, "STRETCH", 60.0)
        patch.setattr(variants, "STEP", 30.0)
        yield


@pytest.fixture(scope="module")
def whole(car) -> VariantRow:
    """Scores of the core as it is."""
    return score(VARIANTS[0], car, [0])


@pytest.mark.parametrize("variant", VARIANTS[1:], ids=[each.name for each in VARIANTS[1:]])
def test_each_part_counts_and_is_back_afterwards(car, whole, variant):
    before = {place: place.present for place in variant.changes}
    row = score(variant, car, [0])
    assert row.likelihood != whole.likelihood
    assert all(np.array_equal(place.present, value) for place, value in before.items())


def test_nothing_is_left_of_what_was_replaced(car, whole):
    assert score(VARIANTS[0], car, [0]) == whole


def test_seeds_are_averaged(car):
    one, other, both = (score(VARIANTS[0], car, seeds) for seeds in ([0], [1], [0, 1]))
    assert one.carried_crps != other.carried_crps
    assert both.carried_crps == pytest.approx((one.carried_crps + other.carried_crps) / 2)


def test_the_command(tmp_path):
    file = tmp_path / "found.json"
    command = ["bench", "ablation", "", "--cars", URBAN, "--seeds", "1", "--json", str(file)]
    result = CliRunner().invoke(app, [*command, "--jobs", "1"])
    assert result.exit_code == 0, result.output
    rows = json.loads(file.read_text())
    assert [row["variant"] for row in rows] == [each.name for each in VARIANTS]
    assert all(row["carried_crps"] > 0.0 for row in rows)
