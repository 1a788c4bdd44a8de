"""What has the name of a file and is none is refused by every reader, and waited for by none."""

import ast
import os
from pathlib import Path

import pytest

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.recover import recover
from evpinn_ros.can.logs import LogFile
from evpinn_ros.can.profile import load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import open_file
from evpinn_ros.core.estimation.state_file import read_state
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.extras.bridges.mqtt import secret_of
from evpinn_ros.extras.fleet.manifest import cars_by_manifest
from evpinn_ros.logs.formats import is_drive_table
from evpinn_ros.logs.sources import open_drive
from evpinn_ros.topics.parameter_file import check_parameter_file

ROOT = Path(__file__).parents[2]
READERS = {
    "pipe.yaml": (load_vehicle, load_profile, check_parameter_file, cars_by_manifest),
    "pipe.csv": (open_drive, is_drive_table, cars_by_manifest),
    "pipe.csv.gz": (open_drive, is_drive_table),
    "pipe.xlsx": (open_drive,),
    "pipe.parquet": (open_drive,),
    "pipe.jsonl": (open_drive,),
    "pipe.log": (lambda path: next(LogFile(path).frames()),),
    "pipe.log.gz": (lambda path: next(LogFile(path).frames()),),
    "pipe.json": (read_state,),
    "pipe.password": (secret_of,),
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
def test_a_bag_whose_metadata_is_a_pipe_is_refused_and_its_file_is_not(tmp_path):
    os.mkfifo(tmp_path / "metadata.yaml")
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(InputError, match=r"metadata\.yaml: a pipe or a device"):
        BagReader(tmp_path)
    with BagReader(tmp_path / "a.mcap") as reader:
        assert not reader.topics


def test_files_and_errors_are_as_ever(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    with open_file(tmp_path / "a") as file:
        assert file.read() == b"abc"
    with pytest.raises(FileNotFoundError):
        open_file(tmp_path / "b")
    with pytest.raises(IsADirectoryError):
        open_file(Path(tmp_path))


BESIDES = {  # what may open by itself, and why
    "evpinn_ros/common/opener.py": "the opener",
    "evpinn_ros/common/sandbox.py": "the limits of its own process, of /proc",
    "evpinn_ros/nodes/processes.py": "environments of processes, of /proc",
    "evpinn_ros/common/writer.py": "folders, to lock and to sync",
    "evpinn_ros/core/energy/rknn.py": "weights of the package",
    "evpinn_ros/common/package_data.py": "tables of the package",
    "evpinn_ros/report/html.py": "a script of the package",
    "evpinn_ros/logs/text_table.py": "bytes in memory, of a file that the opener opened",
}
OPENS = {"open", "fdopen", "read_text", "read_bytes", "ZipFile", "GzipFile", "loadtxt", "memmap"}
OPENS |= {"read_csv", "read_parquet", "read_excel", "read_json", "read_table", "load_workbook"}
OPENS |= {"scan_parquet", "scan_ipc", "scan_csv", "MDF", "MF4Reader"}
OPENS |= {"load", "safe_load", "fromfile", "genfromtxt"}
OPENS |= {"Reader", "AnyReader", "BLFReader", "LogReader", "connect"}  # `Reader` of rosbags
# Whose `open` and `load` are not of files.
OURS = ("reader", "state_file", "self", "car", "car_replay", "json")


def _opening(tree):
    """Calls that open a file to read, by the name of what is called; those to write say so."""
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = getattr(call.func, "attr", getattr(call.func, "id", ""))
        words = [*call.args, *(word.value for word in call.keywords)]
        modes = {word.value for word in words if isinstance(word, ast.Constant)}
        writes = any(isinstance(mode, str) and mode[:1] in "wax" for mode in modes if mode)
        of_it = isinstance(call.func, ast.Attribute) and ast.unparse(call.func.value)
        ours = isinstance(of_it, str) and of_it.split(".")[-1].lstrip("_") in OURS
        nowhere = "os.devnull" in ast.unparse(call)
        if name in OPENS and not writes and not ours and not nowhere:
            yield call, ast.unparse(call)


def test_every_file_from_outside_goes_through_the_one_opener():
    """A library that opens by name comes after `check_file`, or gets what the opener opened."""
    beside = set()
    for path in sorted((ROOT / "evpinn_ros").rglob("*.py")):
        source = path.read_text()
        name = str(path.relative_to(ROOT))
        for call, text in _opening(ast.parse(source)):
            function = next(
                node
                for node in ast.walk(ast.parse(source))
                if not isinstance(node, ast.Module | ast.ClassDef)
                and isinstance(node, ast.FunctionDef)
                and node.lineno <= call.lineno <= node.end_lineno
            )
            guarded = any(
                guard in ast.unparse(function)
                for guard in ("open_file(", "check_file(", "open_unpacked(")
            )
            if name not in BESIDES and not guarded:
                beside.add(f"{name}:{call.lineno}: {text}")
    assert not beside
