"""A file may have any name that its file system takes."""

import os
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.formats import files_of
from evpinn_ros.logs.sources import open_source

TIME = np.arange(300) / 10
SPEED = 8 - 8 * np.cos(TIME / 8)
DRIVE = pl.DataFrame({"t_s": TIME, "speed_mps": SPEED, "power_w": 3e3 + 800 * SPEED})
NAMES = ["drive [1]*{a,b}?", "dr\udcffve [ab]", "x" * 240, "- --out", "%s\t$HOME ~"]


READ_BY = {".csv": range(5), ".parquet": (0, 1, 3), ".jsonl": (0,), ".xlsx": (1, 2, 4)}


@pytest.mark.parametrize(
    ("suffix", "name"),
    [(s, NAMES[i]) for s in READ_BY for i in READ_BY[s]],
    ids=[f"{s}-{i}" for s in READ_BY for i in READ_BY[s]],
)
def test_a_drive_of_any_name_is_read_and_no_other(tmp_path, suffix, name):
    """Beside it lie names that a pattern in it would find too."""
    (tmp_path / f"drive 1b{suffix}").write_bytes(b"not a drive")
    (tmp_path / f"dr\udcffve a{suffix}").write_bytes(b"not a drive")
    path = tmp_path / (name + suffix)
    write(path)
    assert len([*open_source(path, load_vehicle("generic")).readings()]) >= 2 * len(TIME)


def write(path: Path) -> None:
    with open(os.fspath(path), "wb") as file:  # noqa: PTH123 - a name that is no text
        match path.suffix:
            case ".csv":
                DRIVE.write_csv(file)
            case ".parquet":
                DRIVE.write_parquet(file)
            case ".jsonl":
                DRIVE.write_ndjson(file)
            case _:
                openpyxl = pytest.importorskip("openpyxl")
                book = openpyxl.Workbook()
                for row in (DRIVE.columns, *DRIVE.rows()):
                    book.active.append(row)
                book.save(file)


def test_a_folder_of_drives_is_its_files_in_order_and_a_bag_is_itself(tmp_path):
    for name in ("b.csv", "a.csv.gz", "c.log", "notes.md", "i3.json"):
        (tmp_path / name).write_text("t_s,speed_mps,power_w\n0,1,2\n")
    assert [path.name for path in files_of(tmp_path)] == ["a.csv.gz", "b.csv", "c.log"]
    assert files_of(tmp_path / "b.csv") == [tmp_path / "b.csv"]
    (tmp_path / "metadata.yaml").write_text("")
    assert files_of(tmp_path) == [tmp_path]
