import os
from pathlib import Path
import shutil
import sqlite3

from mcap.writer import Writer as McapWriter
import pytest
from rosbags.rosbag2 import Reader

from evpinn_ros.bags import storage as module
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.storage import Storage, change_storage
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.common.errors import InputError

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
URBAN = ROOT / "bags" / "urban"


def raw(path: Path) -> list[tuple[str, str, int, bytes]]:
    with Reader(path) as reader:
        return sorted((c.topic, c.msgtype, t, bytes(data)) for c, t, data in reader.messages())


def test_to_sqlite3_and_back_keeps_every_byte(tmp_path):
    done: list[float] = []
    count = change_storage(URBAN, tmp_path / "sql", Storage.SQLITE3, done.append)
    assert [path.suffix for path in sorted((tmp_path / "sql").iterdir())] == [".yaml", ".db3"]
    assert change_storage(tmp_path / "sql", tmp_path / "back", Storage.MCAP) == count
    assert raw(tmp_path / "sql") == raw(tmp_path / "back") == raw(URBAN)
    assert len(raw(URBAN)) == count and done == sorted(done) and 350 < done[-1] < 361
    with Reader(URBAN) as before, Reader(tmp_path / "back") as after:
        qos = [[c.ext.offered_qos_profiles for c in r.connections] for r in (before, after)]
        assert qos[0] == qos[1]


def test_what_cannot_be_done_is_one_line(tmp_path):
    with BagWriter(tmp_path / "bag"):
        pass
    with pytest.raises(InputError, match="exists already"):
        change_storage(URBAN, tmp_path / "bag", Storage.SQLITE3)
    (file,) = URBAN.glob("*.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[:100_000])
    with pytest.raises(InputError, match="what could be read is in") as caught:
        change_storage(cut, tmp_path / "new", Storage.SQLITE3)
    assert "\n" not in str(caught.value)
    with BagReader(cut) as before, BagReader(tmp_path / "new") as after:
        assert len(messages := [*before.raw_records()]) > 100
        assert [*after.raw_records()] == messages
    with pytest.raises(InputError, match="no such file or folder"):
        change_storage(tmp_path / "nowhere", tmp_path / "other", Storage.MCAP)


def test_a_time_that_the_other_storage_cannot_hold_is_one_line(tmp_path):
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        channel = writer.register_channel(
            "/a", "cdr", writer.register_schema("std_msgs/msg/Empty", "ros2msg", b"")
        )
        writer.add_message(channel, (1 << 64) - 1, b"\0\1\0\0\0", 1)
        writer.finish()
    with pytest.raises(InputError, match="too large"):
        change_storage(tmp_path / "a.mcap", tmp_path / "new", Storage.SQLITE3)
    assert not (tmp_path / "new").exists()


def test_a_message_that_is_too_long_is_left_out_and_told(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "LONGEST_MESSAGE", 300)
    with pytest.raises(
        InputError, match=r"\d+ messages of over 0 MiB left out; what could"
    ) as left:
        change_storage(URBAN, tmp_path / "new", Storage.SQLITE3)
    kept = [message for message in raw(URBAN) if len(message[3]) <= 300]
    assert raw(tmp_path / "new") == kept
    assert f" {len(raw(URBAN)) - len(kept)} messages" in str(left.value) and kept != raw(URBAN)


def test_stopped_it_leaves_a_whole_bag_up_to_there(tmp_path):
    steps = []
    count = change_storage(
        URBAN, tmp_path / "new", Storage.SQLITE3, steps.append, lambda: len(steps) == 3
    )
    with Reader(tmp_path / "new") as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count == count > 10
        assert reader.duration < 5e9


@pytest.mark.parametrize(
    "name",
    ["a#1.mcap", "a?mode=rw.mcap", "a%20b.mcap", "50% [1].mcap", os.fsdecode(b"latin \xe4.mcap")],
)
def test_a_file_of_any_name_changes_its_storage(tmp_path, name):
    """A new `a#1` was written to the file `a` beside it, and was an empty folder itself."""
    (file,) = URBAN.glob("*.mcap")
    shutil.copy(file, tmp_path / name)
    out = tmp_path / f"to {name}" / name
    change_storage(tmp_path / name, out, Storage.SQLITE3)
    with BagReader(out) as bag:
        messages = sorted((c.topic, c.type_name, t, data) for t, c, data in bag.stored())
    assert messages == raw(URBAN)
    there = {path for path in tmp_path.rglob("*") if path.is_file()}
    assert there == {tmp_path / name, out / f"{name}.db3", out / "metadata.yaml"}


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["metadata.yaml", "a.mcap", "a.db3"])
def test_the_storage_of_a_pipe_or_a_device_is_not_changed(tmp_path, name):
    for kind in ("pipe", "device"):
        folder = tmp_path / kind
        folder.mkdir()
        if name == "metadata.yaml":
            shutil.copy(next(URBAN.glob("*.mcap")), folder)
        if kind == "pipe":
            os.mkfifo(folder / name)
        else:
            (folder / name).symlink_to("/dev/zero")
        with pytest.raises(InputError, match=r"a pipe or a device|the file is empty"):
            change_storage(folder, tmp_path / "new", Storage.SQLITE3)
        assert not (tmp_path / "new").exists()


BOMB = "a: &a {x: 1}\nb: &b {<<: [*a, *a]}\n"


def test_qos_of_aliases_is_not_read(tmp_path):
    """Each line that merges the one before takes as much memory again as all before it."""
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/Empty", "ros2msg", b"")
        channel = writer.register_channel("/a", "cdr", schema, {"offered_qos_profiles": BOMB})
        writer.add_message(channel, 1, b"\0\1\0\0\0", 1)
        writer.finish()
    change_storage(URBAN, tmp_path / "sql", Storage.SQLITE3)
    (database,) = (tmp_path / "sql").glob("*.db3")
    with sqlite3.connect(database) as bag:
        bag.execute("UPDATE topics SET offered_qos_profiles = ?", (BOMB,))
    for path in (tmp_path / "a.mcap", database):
        with BagReader(path) as reader:
            assert {channel.qos for channel in reader.channels()} == {None}
            assert sum(1 for _ in reader.log_times()) in (1, len(raw(URBAN)))
        with pytest.raises(InputError, match="offered_qos_profiles cannot be read"):
            change_storage(path, tmp_path / "new", Storage.SQLITE3)
