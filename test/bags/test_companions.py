"""A file that comes with others is read with them, or a line says what was not read."""

from contextlib import closing
from pathlib import Path
import sqlite3
import subprocess
import sys

import pytest
import yaml

from evpinn_ros.bags import sqlite_file
from evpinn_ros.bags.metadata import INFORMATION, METADATA
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.sqlite_file import ROLLBACK
from evpinn_ros.bags.storage import Storage, change_storage
from evpinn_ros.bags.types import encode, new_message
from evpinn_ros.bags.writer import BagWriter, Split
from evpinn_ros.topics.messages import scalar

START, STEP, COUNT = 1_700_000_000_000_000_000, 100_000_000, 600

RECORDER = """
import os, sqlite3, sys
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
path, mode = sys.argv[1:]
bag = sqlite3.connect(path, isolation_level=None)
bag.execute(f"PRAGMA journal_mode = {mode}")
bag.execute("PRAGMA cache_size = 5")  # pages go to the file before they are committed
bag.executescript(Sqlite3Writer.SQLITE_SCHEMA)
bag.execute("INSERT INTO topics VALUES (1, '/a', 'std_msgs/msg/Float64', 'cdr', '', '')")
for number, line in enumerate(sys.stdin):
    if number % 300 == 0:
        bag.execute("BEGIN")
    stamp = 1_700_000_000_000_000_000 + number * 100_000_000
    bag.execute("INSERT INTO messages VALUES (NULL, 1, ?, ?)", (stamp, bytes.fromhex(line)))
    if number == 299:
        bag.execute("COMMIT")
        bag.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        bag.execute("PRAGMA wal_autocheckpoint = 0")
if mode == "WAL":
    bag.execute("COMMIT")
os._exit(9)
"""
"""A recorder that is killed with 300 messages in its database, and 300 more in its journal: a log
has those that were committed, a rollback journal what undoes those that were not."""


INSERT = "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)"


def killed_recording(path: Path, mode: str) -> Path:
    lines = "\n".join(encode(scalar(new_message, i)).hex() for i in range(COUNT))
    command = [sys.executable, "-c", RECORDER, str(path), mode]
    assert subprocess.run(command, input=lines, text=True, timeout=120).returncode == 9
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def numbers(path: Path) -> tuple[list[float], str | None]:
    with BagReader(path) as reader:
        return [record.message.data for record in reader.records()], reader.problem


@pytest.mark.parametrize(
    ("mode", "ending", "count"), [("WAL", "-wal", COUNT), ("DELETE", "-journal", 300)]
)
def test_a_killed_recording_is_read_with_its_journal(tmp_path, mode, ending, count):
    folder = tmp_path / "bag"
    folder.mkdir()
    path = killed_recording(folder / "bag_0.db3", mode)
    assert path.with_name(path.name + ending).stat().st_size
    with closing(sqlite3.connect(f"file:{path}?immutable=1", uri=True)) as alone:
        try:
            (seen,) = alone.execute("SELECT count(*) FROM messages").fetchone()
        except sqlite3.DatabaseError:
            seen = None
    assert seen != count, "without its journal the database must be another one"
    before = contents(folder)
    (tmp_path / "link.db3").symlink_to(path)
    for given in (path, folder, tmp_path / "link.db3"):
        assert numbers(given) == (list(range(count)), None)
    assert contents(folder) == before


@pytest.mark.parametrize("mode", ["WAL", "DELETE"])
def test_another_storage_has_all_messages(tmp_path, mode):
    folder = tmp_path / "bag"
    folder.mkdir()
    path = killed_recording(folder / "bag_0.db3", mode)
    before = contents(folder)
    count = change_storage(path, tmp_path / "new", Storage.MCAP)
    assert numbers(tmp_path / "new") == (list(range(count)), None)
    assert count == {"WAL": COUNT, "DELETE": 300}[mode]
    assert change_storage(folder, tmp_path / "other", Storage.MCAP) == count
    assert contents(folder) == before


@pytest.mark.parametrize("begin", [b"W", b"W" * 5000, b"\0" * 5000])
def test_a_journal_without_a_header_copies_nothing(tmp_path, monkeypatch, begin):
    path = killed_recording(tmp_path / "a.db3", "WAL")
    whole = numbers(path)[0]
    (tmp_path / "a.db3-wal").write_bytes(begin)
    monkeypatch.setattr(sqlite_file, "copy_file", None)  # what would copy
    notes: list[str] = []
    change_storage(path, tmp_path / "new", Storage.MCAP, note=notes.append)
    for read in (path, tmp_path / "new"):
        assert numbers(read) == (whole[:300], None)
    with closing(sqlite3.connect(path)) as alone:  # which deletes it
        assert alone.execute("SELECT count(*) FROM messages").fetchone() == (300,)
    assert ["SQLite does not read it either" in line for line in notes] == [True] * any(begin)


@pytest.mark.timeout(60)
def test_a_journal_of_holes_is_copied_as_it_is(tmp_path, monkeypatch):
    """One of 8 GB filled the disk with zeros."""
    path = killed_recording(tmp_path / "a.db3", "WAL")
    with path.with_name("a.db3-wal").open("r+b") as log:
        log.truncate(8 << 30)
    copied, held = sqlite_file.copy_file, {}

    def and_measured(source, target):
        copied(source, target)
        held[source] = (target.stat().st_size, 512 * target.stat().st_blocks)

    monkeypatch.setattr(sqlite_file, "copy_file", and_measured)
    assert numbers(path) == (list(range(COUNT)), None)
    size, blocks = held[path.with_name("a.db3-wal")]
    assert size == 8 << 30 and blocks < 1 << 20


def test_a_journal_that_cannot_be_read_is_named(tmp_path):
    """One that names another file: SQLite may delete that."""
    path = killed_recording(tmp_path / "a.db3", "WAL")
    log = tmp_path / "a.db3-wal"
    log.write_bytes(log.read_bytes() + ROLLBACK)
    values, problem = numbers(path)
    assert values == list(range(300))
    assert "a.db3-wal beside it could not be read (its journal names other files)" in problem
    assert "messages are missing" in problem


def test_a_recording_that_goes_on_while_it_is_copied_is_not_mixed(tmp_path, monkeypatch):
    path = killed_recording(tmp_path / "a.db3", "WAL")
    copied = sqlite_file.copy_file
    row = (START + COUNT * STEP, encode(scalar(new_message, 0.0)))

    def and_written(source, target):
        copied(source, target)
        if source == path and len(open_bags) < limit:
            bag = sqlite3.connect(path, isolation_level=None)
            open_bags.append(bag)  # or its log would be written to the database
            bag.execute(INSERT, row)
            bag.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            bag.execute(INSERT, row)

    open_bags: list[sqlite3.Connection] = []
    limit = 2
    monkeypatch.setattr(sqlite_file, "copy_file", and_written)
    values, problem = numbers(path)
    assert problem is None and len(values) == COUNT + 4
    limit = 100
    _, problem = numbers(path)
    assert "a recorder is writing it" in problem
    for bag in open_bags:
        bag.close()


def test_one_file_of_a_split_bag_says_so(tmp_path):
    with BagWriter(tmp_path / "bag", split=Split(seconds=10.0)) as writer:
        for i in range(250):
            writer.write("/a", scalar(new_message, i), START + i * STEP)
    values, problem = numbers(tmp_path / "bag" / "bag_1.mcap")
    assert values == list(range(100, 200))
    assert problem.endswith("bag_1.mcap: one of 3 files of its bag; give the folder for all")
    assert numbers(tmp_path / "bag") == (list(range(250)), None)


def test_files_that_an_older_metadata_does_not_list_are_read(tmp_path):
    """As a recorder leaves it that was killed after it began another file."""
    with BagWriter(tmp_path / "bag", split=Split(seconds=10.0)) as writer:
        for i in range(250):
            writer.write("/a", scalar(new_message, i), START + i * STEP)
    metadata = tmp_path / "bag" / METADATA
    document = yaml.safe_load(metadata.read_text())
    del document[INFORMATION]["relative_file_paths"][1:]
    metadata.write_text(yaml.safe_dump(document))
    assert numbers(tmp_path / "bag") == (list(range(250)), None)


def test_databases_beside_mcap_files_are_named(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/a", scalar(new_message, 1.0), START)
    killed_recording(tmp_path / "bag" / "other.db3", "WAL")
    values, problem = numbers(tmp_path / "bag")
    assert values == [1.0] and "MCAP files are read, not other.db3" in problem
