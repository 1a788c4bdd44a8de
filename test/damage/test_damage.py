"""Damaged inputs for every parser: each is read or refused in one line; 3,000 of them a night."""

from datetime import date
import os
from random import Random

import pytest

from evpinn_ros.common import opener
from test.damage.targets import TARGETS
from test.opened import opened_to_read

pytestmark = pytest.mark.slow

OF_BYTES = {"broker", "message", "model", "plan", "frames"}  # read here, for they are no files
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


def test_a_seed_is_sound_and_read_by_way_of_the_opener(target, seeds, folder, monkeypatch):
    """Else no attempt would come behind the first check."""
    monkeypatch.setattr(opener, "_files", {})
    for seed in seeds:
        path = folder / target.file_name
        path.write_bytes(seed)
        with opened_to_read() as read:
            target.parse(path)
        files = {file for file in read if file.is_file() and folder in file.parents}
        if target.name not in OF_BYTES:
            assert path in files
            assert {file for file in files if opener.input_at(file) is None} == set()


@pytest.mark.timeout(1800)
@pytest.mark.filterwarnings("error::RuntimeWarning")
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
