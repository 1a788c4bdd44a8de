"""A log that continues another one has no header; a known app's is read by its layout."""

import gzip
from pathlib import Path

import pytest

from evpinn_ros.drives.sources import open_drive
from evpinn_ros.drives.survey import layout_of

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "nissan_leaf_2013_leafspy"
VERSIONS = ["Log_leaf_170704_01133", "Log_leaf_171026_01133", "Log_leaf_180927_24CA1"]
here = pytest.mark.skipif(not DATA.is_dir(), reason="no shared data")


@here
@pytest.mark.parametrize("name", VERSIONS)
def test_a_continuation_of_leafspy_is_read_as_the_whole_log(tmp_path, name):
    text = gzip.decompress((DATA / f"{name}.csv.gz").read_bytes()).decode("latin-1")
    text = "".join(text.splitlines(keepends=True)[:400])
    header, _, below = text.partition("\n")
    (tmp_path / "whole.csv").write_text(text, "latin-1")
    (tmp_path / "continued.csv").write_text(below, "latin-1")
    whole, continued = (open_drive(tmp_path / f"{each}.csv") for each in ("whole", "continued"))
    assert repr(list(continued.readings())) == repr(list(whole.readings()))  # NaN is no place
    ours = layout_of(
        next(row for row in (line.split(",") for line in below.split("\n")) if row[30:])
    )
    assert len(ours) == header.count(",") + 1


def test_a_row_of_another_kind_has_no_known_layout():
    assert layout_of(["2024-05-01 08:00:00"] + ["3"] * 154) == []
    assert layout_of(["07/04/2017 10:12:19"] + ["3"] * 154) == [], "no cell has 3 mV"
    assert layout_of(["07/04/2017 10:12:19", "3"]) == []
