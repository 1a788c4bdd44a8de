"""Damaged inputs for every parser: each is read or refused in one line; 3,000 of them a night."""

from datetime import date
import os
from random import Random

import pytest

from test.damage.targets import TARGETS

pytestmark = pytest.mark.slow

FEW, NIGHT = 3, 3000 // len(TARGETS) + 1
CHANCE = os.environ.get("EVPINN_NIGHT", date.today().isoformat())
"""Every night tries others; the failure names the variable that repeats them."""


@pytest.fixture(scope="module", params=TARGETS, ids=lambda target: target.name)
def target(request):
    return request.param


@pytest.fixture(scope="module")
def seeds(target):
    return target.seeds()


@pytest.fixture(scope="module")
def folder(target, tmp_path_factory):
    made = tmp_path_factory.mktemp("target")
    target.beside(made)
    return made


def test_a_seed_is_sound(target, seeds, folder):
    """Else no attempt would come behind the first check."""
    for seed in seeds:
        path = folder / target.file_name
        path.write_bytes(seed)
        target.parse(path)


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("attempts", [FEW, pytest.param(NIGHT, marks=pytest.mark.nightly)])
def test_damage_is_refused_in_one_line(target, seeds, folder, attempts, caplog, capfd):
    """And no library shows what is in a file, with its escapes, on the terminal."""
    chance = "day" if attempts == FEW else CHANCE
    for number in range(attempts):
        try:
            target.attack(folder, seeds, Random(f"{chance} {target.name} {number}"))
        except Exception as error:
            raise AssertionError(f"attempt {number}, EVPINN_NIGHT={chance}") from error
    assert caplog.messages == [] and capfd.readouterr() == ("", "")
