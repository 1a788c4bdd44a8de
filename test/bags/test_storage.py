from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader

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
    with pytest.raises(InputError, match="there already"):
        change_storage(URBAN, tmp_path / "bag", Storage.SQLITE3)
    (file,) = URBAN.glob("*.mcap")
    (tmp_path / "cut.mcap").write_bytes(file.read_bytes()[:100_000])
    with pytest.raises(InputError, match="evpinn recover saves") as caught:
        change_storage(tmp_path / "cut.mcap", tmp_path / "new", Storage.SQLITE3)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="does not exist"):
        change_storage(tmp_path / "nowhere", tmp_path / "new", Storage.MCAP)


def test_stopped_it_leaves_a_whole_bag_up_to_there(tmp_path):
    steps = []
    count = change_storage(
        URBAN, tmp_path / "new", Storage.SQLITE3, steps.append, lambda: len(steps) == 3
    )
    with Reader(tmp_path / "new") as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count == count > 10
        assert reader.duration < 5e9
