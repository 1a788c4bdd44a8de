"""The campaign of attacks tells what holds from what does not."""

import os
from random import Random
import time

import pytest

from benchmarks import attacks
from benchmarks.attack_seeds import SEEDS
from benchmarks.attacks import attack, damaged, two_writers
from evpinn_ros.common.errors import InputError

pytestmark = pytest.mark.nightly


@pytest.mark.parametrize("kind", SEEDS)
def test_sound_files_are_read(tmp_path, monkeypatch, kind):
    """Else the campaign would damage what is refused anyway."""
    if kind == "xlsx":
        pytest.importorskip("openpyxl")
    monkeypatch.setattr(attacks, "damaged", lambda seed, chance: seed)
    found = attack(kind, 3, 1, tmp_path / "kept")
    assert (found.files, found.read, found.broken) == (3, 3, [])


def test_damage_repeats_and_differs():
    made = [damaged(bytes(range(256)), Random(each)) for each in (1, 1, 2)]
    assert made[0] == made[1] != made[2]


class Source:
    """Readings of a drive that break a promise."""

    def __init__(self, work):
        self.readings = work


def _trace():
    raise KeyError("a mistake of ours")


def _fill():
    return [bytearray(b"1") * 400_000_000]


def _turn():
    begin = time.process_time()
    while time.process_time() - begin < 0.5:
        pass
    return []


def _hang():
    time.sleep(60)
    return []


def _lines():
    raise InputError("")


@pytest.mark.parametrize(
    ("work", "said"),
    [
        (_trace, "KeyError"),
        (_fill, " MB"),
        (_turn, "takes 0"),
        (_hang, "hangs"),
        (_lines, "no line"),
        (os.abort, "status"),
    ],
)
def test_what_breaks_a_promise_is_told_and_kept(tmp_path, monkeypatch, work, said):
    monkeypatch.setattr(attacks, "MOST_SECONDS", 10.0 if work is not _turn else 0.3)
    monkeypatch.setattr(attacks, "HANGING", 1.0 if work is _hang else 60.0)
    monkeypatch.setattr(attacks, "open_source", lambda *_, **__: Source(work))
    found = attack("csv", 1, 1, tmp_path / "kept")
    assert len(found.broken) == 1 and said in found.broken[0]
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["csv_1_0.csv"]


def test_two_writers_are_caught_where_they_do_not_wait(monkeypatch):
    assert two_writers(30).holds
    torn = "Path(sys.argv[1]).write_text('{'); number += 1\n    try:"
    monkeypatch.setattr(attacks, "WRITER", attacks.WRITER.replace("try:", torn))
    found = two_writers(30)
    assert found.torn and not found.holds
