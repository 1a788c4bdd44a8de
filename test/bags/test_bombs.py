"""Small files that would become large: each is refused, counted or reported, in little memory."""

import gzip
import sqlite3
import struct
import zlib

import can
from lz4.frame import compress as lz4
from mcap.opcode import Opcode
import numpy as np
import pytest
import zstandard

from evpinn_ros.bags import mcap_file
from evpinn_ros.bags.mcap_records import HEAD, LARGEST_CHUNK, MAGIC, MESSAGE
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.can.blf import LARGEST_OBJECT
from evpinn_ros.can.logs import LogFile
from evpinn_ros.drives import open_drive
from evpinn_ros.energy.rknn import load_rknn
from evpinn_ros.errors import InputError
from evpinn_ros.text_lines import LONGEST_LINE

ZEROS = bytes(LARGEST_CHUNK + 1)


def record(opcode, body):
    return HEAD.pack(opcode, len(body)) + body


def chunk(packed, size, compression, start=1):
    name = compression.encode()
    head = struct.pack("<QQQII", start, start, size, 0, len(name)) + name
    return record(Opcode.CHUNK, head + struct.pack("<Q", len(packed)) + packed)


def zstd(data):
    return zstandard.ZstdCompressor().compress(data)


@pytest.mark.parametrize("size", [len(ZEROS), 100, 1 << 60], ids=("told", "hidden", "absurd"))
@pytest.mark.parametrize(("compression", "pack"), [("zstd", zstd), ("lz4", lz4)])
def test_a_chunk_that_unpacks_to_too_much_is_damaged(tmp_path, compression, pack, size):
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + chunk(pack(ZEROS), size, compression))
    with BagReader(path) as reader:
        assert not list(reader.records())
        assert "1 of 1 chunks are damaged" in reader.problem


def test_a_chunk_in_the_summary_is_not_unpacked(tmp_path):
    body = MAGIC + record(Opcode.DATA_END, bytes(4))
    summary = chunk(zstd(ZEROS), len(ZEROS), "zstd")
    footer = record(Opcode.FOOTER, struct.pack("<QQI", len(body), 0, 0))
    path = tmp_path / "a.mcap"
    path.write_bytes(body + summary + footer + MAGIC)
    with BagReader(path) as reader:
        assert not list(reader.records())


def test_order_is_given_up_rather_than_memory(tmp_path, monkeypatch):
    """Chunks that all claim to begin at once, so that none may be let go before the last."""
    monkeypatch.setattr(mcap_file, "MOST_HELD", 3000)
    schema = struct.pack("<HI", 1, 20) + b"std_msgs/msg/Float64" + struct.pack("<II", 0, 0)
    channel = struct.pack("<HHI", 1, 1, 2) + b"/a" + struct.pack("<I", 3) + b"cdr" + bytes(4)
    path = tmp_path / "a.mcap"
    definitions = record(Opcode.SCHEMA, schema) + record(Opcode.CHANNEL, channel)
    path.write_bytes(MAGIC + definitions + chunks_of_one_time(30))
    with BagReader(path) as reader:
        assert [each.message.data for each in reader.records()] == list(range(30))
        assert reader.problem.count("overlap too far") == 1


def chunks_of_one_time(count):
    """Chunks of one message each, all of one time."""
    made = b""
    for number in range(count):
        message = MESSAGE.pack(1, 0, 5, 5) + b"\0\1\0\0" + struct.pack("<d", number)
        body = record(Opcode.MESSAGE, message)
        made += chunk(body, len(body), "", start=5)
    return made


def test_a_packed_file_that_fills_the_disk_is_refused(tmp_path):
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  compression_mode: FILE\n"
        "  relative_file_paths: [a.mcap.zstd]\n"
    )
    (tmp_path / "a.mcap.zstd").write_bytes(zstd(MAGIC + ZEROS))
    with pytest.raises(InputError, match=r"a\.mcap\.zstd: unpacks to over 200 times its size"):
        BagReader(tmp_path)


def test_metadata_of_aliases_is_not_read(tmp_path):
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i + 1}: &a{i + 1} [{', '.join([f'*a{i}'] * 9)}]" for i in range(12)]
    lines += ["rosbag2_bagfile_information:", "  relative_file_paths: *a12"]
    (tmp_path / "metadata.yaml").write_text("\n".join(lines))
    (tmp_path / "a.mcap").write_bytes(MAGIC)
    with BagReader(tmp_path) as reader:
        assert "aliases (*name) are not read" in reader.problem


def test_a_database_that_computes_for_ever_is_refused(tmp_path):
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT)")
        database.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 "
            "FROM n) SELECT id, 1 AS topic_id, id AS timestamp, zeroblob(9) AS data FROM n"
        )
    with pytest.raises(InputError, match=r"a\.db3: no bag: its database has a view"):
        BagReader(path)


@pytest.mark.parametrize("name", ["a.log.gz", "a.asc.gz", "a.trc.gz", "drive.csv.gz"])
def test_a_line_without_an_end_is_not_read(tmp_path, name):
    path = tmp_path / name
    head = b"t_s,speed_mps,power_w\n0,1,2\n" if name == "drive.csv.gz" else b""
    path.write_bytes(gzip.compress(head + b"1" * (LONGEST_LINE + 1)))
    with pytest.raises(InputError, match="a line is longer than 1000000 characters"):
        list(open_drive(path, 350.0).readings() if head else LogFile(path).frames())


def blf(path, objects):
    """A .blf log of one frame, and these bytes as each of its next two containers."""
    with can.BLFWriter(str(path)) as writer:
        writer.on_message_received(can.Message(arbitration_id=1, data=b"1", timestamp=1e9))
    packed = zlib.compress(objects)
    size = 16 + 16 + len(packed)
    head = struct.pack("<4sHHII", b"LOBJ", 16, 1, size, 10)
    container = head + struct.pack("<H6xL4x", 2, len(objects)) + packed
    path.write_bytes(path.read_bytes() + 2 * (container + bytes(size % 4)))


NO_SIZE = struct.pack("<4sHHII", b"LOBJ", 32, 9, 0, 1) + bytes(32)
ENDLESS = struct.pack("<4sHHII", b"LOBJ", 32, 1, 1 << 31, 1) + bytes(LARGEST_OBJECT)


@pytest.mark.parametrize(
    ("objects", "reason"),
    [(NO_SIZE, "an object has no size"), (ENDLESS, "an object is larger than")],
)
def test_a_blf_object_that_never_ends(tmp_path, objects, reason):
    """python-can reads the first for ever and keeps all that follows the second."""
    path = tmp_path / "a.blf"
    blf(path, objects)
    log = LogFile(path)
    assert len(list(log.frames())) == 1
    assert reason in log.problem


def test_arrays_that_unpack_to_too_much(tmp_path):
    path = tmp_path / "w.npz"
    np.savez_compressed(path, n1_weight0=np.zeros(1 << 20))
    with pytest.raises(InputError, match=r"w\.npz: .* more than 1048576"):
        load_rknn(path)
