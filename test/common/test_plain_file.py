"""What has the name of a file and is none is refused by every reader, and waited for by none."""

import os
from pathlib import Path

import pytest

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.recover import recover
from evpinn_ros.can.logs import LogFile
from evpinn_ros.can.profile import load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_file import open_file
from evpinn_ros.drives.formats import is_drive_table
from evpinn_ros.drives.sources import open_drive
from evpinn_ros.estimation.state_file import read_state
from evpinn_ros.fleet.manifest import cars_by_manifest
from evpinn_ros.topics.parameter_file import check_parameter_file
from evpinn_ros.vehicle.files import load_vehicle

READERS = {
    "pipe.yaml": (load_vehicle, load_profile, check_parameter_file, cars_by_manifest),
    "pipe.csv": (open_drive, is_drive_table, cars_by_manifest),
    "pipe.csv.gz": (open_drive, is_drive_table),
    "pipe.xlsx": (open_drive,),
    "pipe.parquet": (open_drive,),
    "pipe.log": (lambda path: next(LogFile(path).frames()),),
    "pipe.log.gz": (lambda path: next(LogFile(path).frames()),),
    "pipe.json": (read_state,),
    "pipe.mcap": (BagReader, lambda path: recover(path, path.with_name("new"))),
    "pipe.db3": (BagReader,),
}


@pytest.mark.timeout(20)
@pytest.mark.parametrize("kind", ["pipe", "device"])
@pytest.mark.parametrize("name", READERS)
def test_no_reader_waits_for_a_pipe_or_a_device(tmp_path, name, kind):
    path = tmp_path / name
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    for read in READERS[name]:
        with pytest.raises(InputError):
            read(path)


@pytest.mark.timeout(20)
def test_a_bag_whose_metadata_is_a_pipe_is_read_without(tmp_path):
    os.mkfifo(tmp_path / "metadata.yaml")
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n")
    with BagReader(tmp_path) as reader:
        assert "a pipe or a device" in reader.problem


def test_files_and_errors_are_as_ever(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    with open_file(tmp_path / "a") as file:
        assert file.read() == b"abc"
    with pytest.raises(FileNotFoundError):
        open_file(tmp_path / "b")
    with pytest.raises(IsADirectoryError):
        open_file(Path(tmp_path))
