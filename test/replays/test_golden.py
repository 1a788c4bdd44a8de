"""The bundled bags give what they gave when somebody last looked (`make golden`)."""

from pathlib import Path
import runpy
from types import SimpleNamespace

import numpy as np
import pytest

pytestmark = pytest.mark.slow

golden = SimpleNamespace(**runpy.run_path(str(Path(__file__).with_name("golden.py"))))


def drives():
    """Every change is checked on the whole town drive, the others in the night."""
    for number, drive in enumerate(golden.DRIVES):
        marks = [pytest.mark.nightly] if number else []
        yield pytest.param(drive, id=drive.path.stem, marks=marks)


def test_the_largest_change_of_a_topic_is_told():
    old = {("a", 0, "30"): 4.0, ("a", 0, "60"): 2.0, ("b", 0, "30"): 1.0, ("c", 0, "30"): np.nan}
    new = {("a", 0, "30"): 4.1, ("a", 0, "60"): 2.2, ("c", 0, "30"): np.nan, ("d", 0, "30"): 0.0}
    assert list(golden.differences(old, old, 1e-6)) == []
    a, b, d = golden.differences(old, new, 1e-6)
    assert a == "a: 2 changed, by at most 5.0e-02 of the largest: number 0 at 60 s, 2 -> 2.2"
    assert "inf of the largest" in b and "inf of the largest" in d


@pytest.mark.parametrize("drive", list(drives()))
def test_outputs_are_those_of_the_record(drive):
    record = golden.load(drive.path)
    assert len(record) > 50
    changed = list(golden.differences(record, golden.outputs(drive), drive.near))
    assert not changed, "look at `make golden`:\n" + "\n".join(changed)
