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


@pytest.mark.parametrize("drive", list(drives()))
def test_outputs_are_those_of_the_record(drive):
    record = golden.load(drive.path)
    assert len(record) > 50
    changed = list(golden.differences(record, golden.outputs(drive), drive.near))
    assert not changed, "look at `make golden`:\n" + "\n".join(changed)
