"""The bundled bags give what they gave when somebody last looked (`make golden`)."""

from pathlib import Path
import runpy
from types import SimpleNamespace

import pytest

pytestmark = pytest.mark.slow

golden = SimpleNamespace(**runpy.run_path(str(Path(__file__).with_name("golden.py"))))


def drives():
    """Every change is checked on the whole town drive, the others in the night."""
    for number, drive in enumerate(golden.DRIVES):
        marks = [pytest.mark.nightly] if number else []
        yield pytest.param(drive, id=drive.path.stem, marks=marks)


@pytest.mark.parametrize("drive", drives())
def test_outputs_are_those_of_the_record(drive):
    record = golden.load(drive.path)
    assert len(record) > 50
    changed = list(golden.differences(record, golden.outputs(drive), drive.near))
    assert not changed, "look at `make golden`:\n" + "\n".join(changed)


def test_a_number_that_changed_came_or_went_is_told():
    old = {("a", 0, "30"): 1.0, ("a", 0, "60"): 1000.0, ("b", 0, "30"): float("nan")}
    assert not list(golden.differences(old, old, 1e-6))
    new = {**old, ("a", 0, "30"): 1.002, ("c", 0, "30"): 1.0}
    del new["b", 0, "30"]
    lines = list(golden.differences(old, new, 1e-6))
    assert [line.partition(":")[0] for line in lines] == [
        "('a', 0, '30')",
        "('b', 0, '30')",
        "('c', 0, '30')",
    ]
    assert not list(golden.differences(old, {**old, ("a", 0, "30"): 1.0009}, 1e-6))
