"""Random exports are read right, or what is assumed is said, or they are refused with a reason."""

from collections import Counter
from pathlib import Path
import sys

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from exports import measured, opened
from random_exports import Export, random_export

from evpinn_ros.common.errors import InputError

pytestmark = pytest.mark.slow

BLOCK = 50
MOST_WRONG = 0.02  # of way and energy
MOST_REFUSED = 0.03  # of those that a person could read
MOST_ASSUMED_WRONGLY = 0.1
MOST_DOUBTED_WRONGLY = 0.1
LEAST_RIGHT = 0.7  # of those that a person could read and would not doubt
NIGHT = [pytest.param(block, marks=pytest.mark.nightly) for block in range(2, 100)]


def verdict(folder: Path, export: Export) -> str:
    """Verdict on an export: `right`, `assumed` wrongly, `silent`, `refused`, or `doubted`.

    What a person would not read or would doubt counts neither as refused nor as assumed.
    """
    try:
        source = opened(folder, export.data)
        distance, energy = measured(source)
    except InputError:
        return "refused, as by a person" if export.refused else "refused"
    ratios = distance / export.drive.distance, energy / export.drive.energy
    if all(abs(ratio - 1.0) < MOST_WRONG for ratio in ratios):
        return "doubted wrongly" if source.doubts and not export.doubtful else "right"
    said = ("is assumed", "so it is not used")
    if export.doubtful and (source.doubts or any(said[1] in note for note in source.notes)):
        return "doubted, as by a person"
    return "assumed" if any(word in note for note in source.notes for word in said) else "silent"


@pytest.mark.parametrize("block", [0, 1, *NIGHT])
def test_no_export_is_read_wrong_in_silence(tmp_path, block):
    verdicts: Counter[str] = Counter()
    examples = {}
    for seed in range(BLOCK * block, BLOCK * (block + 1)):
        export = random_export(seed)
        word = verdict(tmp_path, export)
        verdicts[word] += 1
        examples.setdefault(word, export.kind)
    assert not verdicts["silent"], examples["silent"]
    assert verdicts["refused"] <= MOST_REFUSED * BLOCK, examples["refused"]
    assert verdicts["assumed"] <= MOST_ASSUMED_WRONGLY * BLOCK, examples["assumed"]
    assert verdicts["doubted wrongly"] <= MOST_DOUBTED_WRONGLY * BLOCK, examples["doubted wrongly"]
    told = BLOCK - sum(count for word, count in verdicts.items() if word.endswith("by a person"))
    assert verdicts["right"] > LEAST_RIGHT * told, verdicts


@pytest.mark.parametrize("seed", [4756])
def test_an_export_that_was_read_wrong_once_is_read_right(tmp_path, seed):
    """4756: a hole of 80 s is filled with lines, and 10.00002 s long where a cell is missing."""
    assert verdict(tmp_path, random_export(seed)) == "right"
