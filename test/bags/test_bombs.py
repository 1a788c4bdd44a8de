"""Small files that would become large: each is refused, counted or reported, in little memory."""

from collections import Counter
from contextlib import closing
import gzip
import heapq
import os
import re
import sqlite3
import struct
import subprocess
import sys
from types import SimpleNamespace
import zlib

import can
from lz4.frame import compress as lz4
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer
import numpy as np
import pytest
from rosbags.rosbag2 import storage_mcap
import zstandard

from evpinn_ros.bags import limits, mcap_file, mcap_records
from evpinn_ros.bags.limits import LONGEST_CHUNK, LONGEST_MESSAGE
from evpinn_ros.bags.mcap_records import HEAD, MAGIC, PRIVATE
from evpinn_ros.bags.metadata import INFORMATION, MOST_METADATA
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.recover import recover
from evpinn_ros.bags.storage import Storage, change_storage
from evpinn_ros.can.logs import LogFile, _Lines
from evpinn_ros.common import opener, sandbox
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import FREE_BYTES, LONGEST_LINE, most_unpacked
from evpinn_ros.common.yaml_section import load_plain
from evpinn_ros.core.signals.readings import SpeedReading
from evpinn_ros.extras.paper import checkpoint
from evpinn_ros.logs.sources import open_drive
from test.damage.seeds import database

pytestmark = pytest.mark.torch

MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; then data
ZEROS = bytes(64 * FREE_BYTES)


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


@pytest.mark.parametrize(("compression", "pack"), [("zstd", zstd), ("lz4", lz4)])
@pytest.mark.parametrize("size", [100, LONGEST_CHUNK + 1])
def test_rosbags_unpacks_no_more_than_a_chunk_may_hold(compression, pack, size):
    """It has no limit of its own; an index that says 100 bytes is sound until it is unpacked."""
    with pytest.raises(ValueError, match="damaged" if size == 100 else "above the limit"):
        storage_mcap.decompress(pack(ZEROS), compression, size, 0)


def test_a_chunk_in_the_summary_is_not_unpacked(tmp_path):
    body = MAGIC + record(Opcode.DATA_END, bytes(4))
    summary = chunk(zstd(ZEROS), len(ZEROS), "zstd")
    footer = record(Opcode.FOOTER, struct.pack("<QQI", len(body), 0, 0))
    path = tmp_path / "a.mcap"
    path.write_bytes(body + summary + footer + MAGIC)
    with BagReader(path) as reader:
        assert not list(reader.records())


def test_order_is_given_up_rather_than_memory(tmp_path, monkeypatch):
    """Chunks of which each begins before the last one, so that none may be let go."""
    monkeypatch.setattr(mcap_file, "MOST_HELD", 3000)
    chunks = b"".join(chunk_of(number, 100 - number) for number in range(30))
    with BagReader(few_types(tmp_path / "a.mcap", chunks)) as reader:
        assert sorted(stored.message.data for stored in reader.records()) == list(range(30))
        assert reader.problem.count("overlap too far") == 1


def chunk_of(number, stamp):
    """A chunk of one message."""
    message = MESSAGE.pack(1, 0, stamp, stamp) + b"\0\1\0\0" + struct.pack("<d", number)
    body = record(Opcode.MESSAGE, message)
    return chunk(body, len(body), "", start=stamp)


def few_types(path, chunks, end=b""):
    """A file of one topic and these chunks, with or without an end."""
    schema = struct.pack("<HI", 1, 20) + b"std_msgs/msg/Float64" + struct.pack("<II", 0, 0)
    channel = struct.pack("<HHI", 1, 1, 2) + b"/a" + struct.pack("<I", 3) + b"cdr" + bytes(4)
    path.write_bytes(
        MAGIC + record(Opcode.SCHEMA, schema) + record(Opcode.CHANNEL, channel) + chunks + end
    )
    return path


def test_chunks_that_overlap_are_put_in_order_once(tmp_path, monkeypatch):
    """Each of them reaches to the end: to sort them anew at every chunk took a minute and more."""
    calls = Counter()

    def push(heap, item):
        calls["push"] += 1
        heapq.heappush(heap, item)

    def pop(heap):
        calls["pop"] += 1
        return heapq.heappop(heap)

    monkeypatch.setattr(mcap_file, "heapq", SimpleNamespace(heappush=push, heappop=pop))
    body = b""
    for number in range(4000):
        message = struct.pack("<d", number)
        in_time = record(Opcode.MESSAGE, MESSAGE.pack(1, 0, number, 5) + b"\0\1\0\0" + message)
        late = record(Opcode.MESSAGE, MESSAGE.pack(1, 0, 10**9, 5) + b"\0\1\0\0" + message)
        body += chunk(in_time + 9 * late, len(in_time + 9 * late), "", start=number)
    with BagReader(few_types(tmp_path / "a.mcap", body)) as reader:
        times = [raw.log_time_ns for raw in reader.raw_records()]
    assert len(times) == 40_000 and times == sorted(times)
    assert calls == {"push": 40_000, "pop": 40_000}


def unsummed(path):
    message = record(Opcode.MESSAGE, MESSAGE.pack(1, 0, 5, 5) + bytes(20))
    chunks = (chunk(message * count, count * len(message), "", 5) for count in (1, *9 * [11]))
    return few_types(path, b"".join(chunks))


def summed(path):
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=10 * 51, compression=CompressionType.NONE)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data")
        channel = writer.register_channel("/a", "cdr", schema)
        for stamp in range(1, 101):
            writer.add_message(channel, stamp, bytes(20), stamp)
        writer.finish()
    return path


@pytest.mark.parametrize("write", [unsummed, summed])
@pytest.mark.parametrize(
    ("name", "limit", "most", "reason"),
    [
        ("most_unpacked", lambda size: 35 * 51, 35, "over 200 times its size"),
        ("LONGEST_CHUNK", 9 * 51, 9, "above the limit"),
    ],
)
def test_each_limit_holds_with_and_without_a_summary(
    tmp_path, monkeypatch, write, name, limit, most, reason
):
    """Chunks of some ten messages and one of one; a sound summary is no leave to go beyond."""
    for module in (limits, mcap_records):
        monkeypatch.setattr(module, name, limit, raising=False)
    path = write(tmp_path / "a.mcap")
    with BagReader(path) as reader:
        read = sum(1 for _ in reader.raw_records())
        assert 0 < read <= most
        assert "chunks are damaged" in reader.problem
    (report,) = recover(path, tmp_path / "new")
    assert report.messages == read and reason in report.losses[0].reason


def test_messages_packed_one_by_one_are_bounded_together(tmp_path):
    """Each may unpack to a megabyte by itself."""
    packed = record(Opcode.MESSAGE, MESSAGE.pack(1, 0, 5, 5) + zstd(bytes(FREE_BYTES)))
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  compression_mode: MESSAGE\n"
        "  relative_file_paths: [a.mcap]\n"
    )
    path = few_types(tmp_path / "a.mcap", packed * 1000)
    with BagReader(tmp_path) as reader:
        read = sum(len(raw.message) for raw in reader.raw_records())
        assert 0 < read <= most_unpacked(path.stat().st_size) < 1000 * FREE_BYTES
        assert "messages cannot be unpacked" in reader.problem


def test_a_packed_file_that_fills_the_disk_is_refused(tmp_path):
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  compression_mode: FILE\n"
        "  relative_file_paths: [a.mcap.zstd]\n"
    )
    (tmp_path / "a.mcap.zstd").write_bytes(zstd(MAGIC + ZEROS))
    with pytest.raises(InputError, match=r"a\.mcap\.zstd: unpacks to over 200 times its size"):
        BagReader(tmp_path)


MEASURED = """
from contextlib import suppress
import re, sys
from evpinn_ros.cli.main import main
for command in sys.argv[1:]:
    sys.argv = ["evpinn", *command.split()]
    with suppress(SystemExit):
        main()
    peak = int(re.search("VmHWM:\\s*(\\d+)", open("/proc/self/status").read())[1]) / 1024
    print("MB after", command, peak)
"""


def one_message(path):
    """A chunk that one message fills."""
    body = record(Opcode.MESSAGE, MESSAGE.pack(1, 0, 5, 5) + bytes(LONGEST_CHUNK - 100))
    few_types(path, record(PRIVATE, NOISE) + chunk(zstd(body), len(body), "zstd"))


def sound_messages(path):
    """A sound file of one as long as it may be, and one that does not shrink."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/Empty", "ros2msg", b"")
        channel = writer.register_channel("/a", "cdr", schema)
        for data in (bytes(LONGEST_CHUNK - 100), bytes(LONGEST_MESSAGE), NOISE):
            writer.add_message(channel, 5, data, 5)
        writer.finish()


def many_messages(path):
    body = record(Opcode.MESSAGE, MESSAGE.pack(1, 0, 5, 5) + bytes(500)) * (LONGEST_CHUNK // 540)
    few_types(path, record(PRIVATE, NOISE) + chunk(zstd(body), len(body), "zstd"))


def definitions(path, size=LONGEST_CHUNK // 5 - 100, total=LONGEST_CHUNK):
    """Types that a chunk defines; one letter makes four bytes of each."""
    text = ("\N{GRINNING FACE}" + "x" * size).encode()
    schemas = [
        record(
            Opcode.SCHEMA,
            struct.pack("<HI", 2 + number, 1) + b"a" + struct.pack("<II", 0, len(text)) + text,
        )
        for number in range(total // (size + 100))
    ]
    channels = [
        struct.pack("<HHI", 2 + number, 2 + number, 2) + b"/%d" % number + struct.pack("<I", 0)
        for number in range(len(schemas))
    ]
    body = b"".join(
        [*schemas, *(record(Opcode.CHANNEL, channel + bytes(4)) for channel in channels)]
    )
    few_types(path, record(PRIVATE, NOISE) + chunk(zstd(body), len(body), "zstd"))


def whole_definitions(path):
    definitions(path, limits.MOST_DEFINITIONS // 8 - 100, limits.MOST_DEFINITIONS - 1000)


NOISE = np.random.default_rng(1).bytes(400_000)


@pytest.mark.slow
@pytest.mark.parametrize(
    "write", [one_message, sound_messages, many_messages, definitions, whole_definitions]
)
def test_a_bag_costs_no_command_200_mb(tmp_path, write):
    """Files of 0.4 MB, by each limit of what a chunk holds; they took up to 570 MB."""
    write(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").stat().st_size < 700_000
    commands = "info a.mcap", "recover a.mcap saved", "convert a.mcap new --storage mcap"
    ended = subprocess.run(
        [sys.executable, "-c", MEASURED, *commands], cwd=tmp_path, capture_output=True, text=True
    )
    assert "Traceback" not in ended.stderr
    peaks = re.findall(r"^MB after .* ([\d.]+)$", ended.stdout, re.M)
    assert len(peaks) == len(commands) and float(peaks[-1]) < 200.0, ended


def test_what_zstd_may_hold_is_bounded(tmp_path):
    """A window of 128 MiB is held whole; one of 64 MiB is read, by chunk and by file."""
    for log, refused in ((26, False), (27, True)):
        window = zstandard.ZstdCompressionParameters(window_log=log, write_content_size=False)
        pack = zstandard.ZstdCompressor(compression_params=window).compressobj()
        packed = pack.compress(bytes(1000)) + pack.flush()
        path = tmp_path / f"{log}.zstd"
        path.write_bytes(packed)
        if refused:
            with pytest.raises(ValueError, match="damaged"):
                limits.unpacked("zstd", packed, 1000)
            with pytest.raises(InputError, match=r"27\.zstd: cannot be unpacked"):
                BagReader(path)
        else:
            assert limits.unpacked("zstd", packed, 1000) == bytes(1000)
            with pytest.raises(InputError, match="not an MCAP"):
                BagReader(path)


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


ENDLESS = (
    "CREATE VIEW endless AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
    "SELECT i FROM n"
)
COMPUTED = "CREATE TABLE computed(a INTEGER, b BLOB GENERATED ALWAYS AS (zeroblob(a)))"


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (ENDLESS, "has a view that computes"),
        (COMPUTED, "has a table that computes"),
        ("ALTER TABLE messages ADD x GENERATED ALWAYS AS (zeroblob(1e9))", "table that computes"),
        (f"ALTER TABLE topics ADD x DEFAULT '{'x' * 90_000}'", "table that computes"),
        ("CREATE TRIGGER t AFTER INSERT ON topics BEGIN SELECT 1; END", "a trigger that computes"),
        (
            "".join(f"CREATE TABLE t{number}(a);" for number in range(100)) + COMPUTED,
            "more than 100 tables",
        ),
        (
            "CREATE TABLE t AS SELECT t.* FROM topics AS t, topics; DROP TABLE topics;"
            "ALTER TABLE t RENAME TO topics",
            "topics with one id",
        ),
        (
            "WITH RECURSIVE n(i) AS (SELECT 3 UNION ALL SELECT i + 1 FROM n LIMIT 300000)"
            "INSERT INTO topics(id, name, type, serialization_format, offered_qos_profiles, "
            "type_description_hash) SELECT i, i, '', '', '', '' FROM n",
            "over 10000 topics",
        ),
        ("CREATE TABLE t(a PRIMARY KEY) WITHOUT ROWID", "computes values or lacks row"),
        (f"CREATE TABLE t(a /*{'x' * 100_000}*/)", "describes its tables in more than 100000"),
        ("UPDATE topics SET name = printf('%.*c', 17000000, 'x')", "8388608 bytes of topics"),
        ("DROP TABLE messages", "has no table 'messages'"),
        ("ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS SELECT * FROM m", "a view"),
    ],
)
def test_a_database_of_any_structure_is_refused_by_reading_and_converting(
    tmp_path, change, reason
):
    path = tmp_path / "a.db3"
    path.write_bytes(database()[0])
    with closing(sqlite3.connect(path)) as bag, bag:
        bag.executescript(change)
    for read in (BagReader, lambda path: change_storage(path, tmp_path / "new", Storage.MCAP)):
        with pytest.raises(InputError, match=reason):
            read(path)
    assert not (tmp_path / "new").exists()


def test_rows_that_are_no_messages_are_counted(tmp_path):
    path = tmp_path / "a.db3"
    path.write_bytes(database()[0])
    with closing(sqlite3.connect(path)) as bag, bag:
        bag.execute("UPDATE messages SET data = 1000000000 WHERE id = 3")
        bag.execute("UPDATE messages SET timestamp = 'noon' WHERE id = 5")
        bag.execute("UPDATE messages SET timestamp = -1 WHERE id = 7")
    with BagReader(path) as reader:
        assert sum(1 for _ in reader.records()) == 37
        assert "3 messages without a time or data are not read" in reader.problem
    with pytest.raises(InputError, match="3 messages without a time"):
        change_storage(path, tmp_path / "new", Storage.MCAP)


def test_a_database_whose_pages_lead_to_one_another_is_refused(tmp_path):
    """SQLite counts 300 ** 6 rows of a page in a file of 60 kB."""
    path = tmp_path / "a.db3"
    path.write_bytes(database()[0])
    with closing(sqlite3.connect(path)) as bag:
        ((root,),) = bag.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'")
        ((size,),) = bag.execute("PRAGMA page_size")
    pages = [path.read_bytes()[at : at + size] for at in range(0, path.stat().st_size, size)]
    below = pages[root - 1]
    for _ in range(6):
        pages.append(below)  # as the last page, to which 300 cells of the next lead
        cells = struct.pack(">IB", len(pages), 1) * 300
        begin = size - len(cells)
        places = b"".join(struct.pack(">H", begin + 5 * number) for number in range(300))
        head = struct.pack(">BHHHBI", 5, 0, 300, begin, 0, len(pages)) + places
        below = head + bytes(begin - len(head)) + cells
    pages[root - 1] = below
    content = bytearray(b"".join(pages))
    content[28:32] = struct.pack(">I", len(pages))
    path.write_bytes(content)
    with pytest.raises(
        InputError, match=r"a\.db3: no bag: its database claims more bytes than its file has$"
    ):
        BagReader(path)


@pytest.mark.parametrize(
    "tables", ["CREATE TABLE t{}(a);" * 101, f"CREATE TABLE t(a/*{'x' * 100_000}*/)"]
)
def test_a_schema_is_measured_before_sqlite_loads_it(tmp_path, monkeypatch, tables):
    """Texts that share their pages: 6 MB took 660 MB and 44 s, 27 s before the first query."""
    path = tmp_path / "a.db3"
    with closing(sqlite3.connect(path)) as bag, bag:
        bag.executescript(tables.format(*range(101)))
    monkeypatch.setattr(sqlite3, "connect", None)
    with pytest.raises(InputError, match=r"no bag: its database (has more|describes its tables)"):
        BagReader(path)


@pytest.mark.parametrize(
    ("shared", "said"),
    [
        ("messages", "its database claims more bytes than its file has"),
        ("by_time", "an index lists more bytes than the file has"),
    ],
)
def test_a_database_whose_messages_share_their_pages_is_refused(tmp_path, shared, said):
    """Rows that state the payload of another: 3 MB became 3.6 GB, in 52 s and 830 MB."""
    path = tmp_path / "a.db3"
    with closing(sqlite3.connect(path)) as bag, bag:
        bag.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data BLOB);"
            "CREATE INDEX by_time ON messages(timestamp, topic_id, data);"
            "INSERT INTO topics VALUES (1, '/a', 'std_msgs/msg/Empty', 'cdr');"
        )
        rows = [(1, 1, bytes(100_000)), (1, 2, bytes(100_000))]
        bag.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    content = bytearray(path.read_bytes())
    with closing(sqlite3.connect(path)) as bag:
        ((root,),) = bag.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", (shared,))
        ((size,),) = bag.execute("PRAGMA page_size")
    page = (root - 1) * size
    (first,) = struct.unpack_from(">H", content, page + 8)  # the cell of the first row
    count = 200  # rows that are that cell
    content[page + 3 : page + 5] = struct.pack(">H", count)
    content[page + 8 : page + 8 + 2 * count] = struct.pack(">H", first) * count
    path.write_bytes(content)
    with pytest.raises(InputError, match=said), BagReader(path) as reader:
        assert sum(len(data) for *_, data in reader.stored()) <= len(content)
        raise InputError(reader.problem)


def test_a_topic_without_a_name_costs_the_others_nothing(tmp_path):
    path = tmp_path / "a.db3"
    path.write_bytes(database()[0])
    with closing(sqlite3.connect(path)) as bag, bag:
        bag.executescript(
            "CREATE TABLE t AS SELECT * FROM topics; UPDATE t SET name = NULL WHERE id = 2;"
            "DROP TABLE topics; ALTER TABLE t RENAME TO topics"
        )
    with BagReader(path) as reader:
        assert [*reader.topics] == ["/ev/vehicle/speed"]
        assert sum(1 for _ in reader.records()) == 20
        assert "a topic without a name is not read" in reader.problem


@pytest.mark.parametrize("name", ["a#1.db3", "a?mode=rw.db3", "a%41.db3", "50% [1].db3"])
def test_a_database_of_any_name_is_read(tmp_path, name):
    (tmp_path / name).write_bytes(database()[0])
    with BagReader(tmp_path / name) as reader:
        assert reader.problem is None and sum(1 for _ in reader.records()) == 40


@pytest.mark.parametrize("name", ["a.log.gz", "a.asc.gz", "a.trc.gz", "drive.csv.gz"])
def test_a_line_without_an_end_is_not_read(tmp_path, name):
    path = tmp_path / name
    head = b"t_s,speed_mps,power_w\n0,1,2\n" if name == "drive.csv.gz" else b""
    path.write_bytes(gzip.compress(head + b"1" * (LONGEST_LINE + 1)))
    with pytest.raises(InputError, match="a line is longer than 1000000 characters"):
        list(open_drive(path, 350.0).readings() if head else LogFile(path).frames())


@pytest.mark.timeout(60)
def test_zeros_are_not_read_to_their_end(tmp_path):
    """Lines of them are no more than others; 8 GB took 200 lines, or 2 GiB."""
    for name in ("a.log", "a.asc", "a.trc", "a.jsonl"):
        with (tmp_path / name).open("wb") as file:
            file.truncate(8 << 30)
    lines = _Lines((tmp_path / "a.log").open(), ".log")
    assert len(lines.peek(200)) == 1
    for name in ("a.log", "a.asc", "a.trc"):
        with pytest.raises(InputError, match="longer than 1000000 characters"):
            list(LogFile(tmp_path / name).frames())
    rows = "".join(f'{{"t_s": {t}, "speed_mps": 10, "power_w": 2}}\n' for t in range(5000))
    with (tmp_path / "a.jsonl").open("r+") as file:
        file.write(rows)
    drive = open_drive(tmp_path / "a.jsonl")
    assert sum(isinstance(reading, SpeedReading) for reading in drive.readings()) == 5000
    assert "1 lines are no JSON objects, the first is line 5001" in drive.problem


def test_zeros_behind_a_drive_are_not_read_to_their_end(tmp_path):
    """A loss of power leaves some; a sparse file of 8 GB was read for 90 s."""
    path = tmp_path / "drive.csv"
    rows = [f"{second},{10 + second % 7},380,{20 + second % 5}\n" for second in range(5000)]
    for zeros, problem in ((5000, None), (8 << 30, "endless zero bytes")):
        with path.open("w") as file:
            file.write("time,speed [m/s],voltage [V],current [A]\n" + "".join(rows))
            file.truncate(file.tell() + zeros)
        drive = open_drive(path, 350.0)
        assert sum(1 for reading in drive.readings() if isinstance(reading, SpeedReading)) == 5000
        assert problem is None or problem in drive.problem


def test_gzipped_text_that_unpacks_to_too_much_is_cut_there(tmp_path, monkeypatch):
    """70 kB of gzip were 8 million rows, and a minute and a half."""
    monkeypatch.setattr(opener, "FREE_BYTES", 1 << 16)  # or the rows take seconds
    rows = b"t_s,speed_mps,power_w\n" + b"0,1,2\n" * 200_000
    (tmp_path / "drive.csv.gz").write_bytes(gzip.compress(rows))
    drive = open_drive(tmp_path / "drive.csv.gz", 350.0)
    size = (tmp_path / "drive.csv.gz").stat().st_size
    read = sum(1 for _ in drive.readings()) + drive.dropped.total()
    assert 0 < 6 * read <= 2 * most_unpacked(size) < 6 * 200_000
    assert "unpacks to over 200 times its size" in drive.problem
    (tmp_path / "a.log.gz").write_bytes(gzip.compress(b"(1.000000) can0 001#00\n" * 60_000))
    log = LogFile(tmp_path / "a.log.gz")
    read = sum(1 for _ in log.frames())
    size = (tmp_path / "a.log.gz").stat().st_size
    assert 0 < 23 * read <= most_unpacked(size) < 23 * 60_000
    assert "unpacks to over 200 times its size" in log.problem


def blf(path, objects):
    """A .blf log of one frame, and these bytes as each of its next three containers."""
    with can.BLFWriter(str(path)) as writer:
        writer.on_message_received(can.Message(arbitration_id=1, data=b"1", timestamp=1e9))
    packed = zlib.compress(objects)
    size = 16 + 16 + len(packed)
    head = struct.pack("<4sHHII", b"LOBJ", 16, 1, size, 10)
    container = head + struct.pack("<H6xL4x", 2, len(objects)) + packed
    path.write_bytes(path.read_bytes() + 3 * (container + bytes(size % 4)))


@pytest.mark.slow
def test_a_blf_object_that_never_ends(tmp_path, monkeypatch):
    """python-can reads it for ever, so until a second of the processor is spent."""
    limits = sandbox.ParserLimits(1 << 30, 1 << 30, 1)
    monkeypatch.setattr(sandbox.ParserLimits, "of", lambda _: limits)
    (tmp_path / "sitecustomize.py").write_text(  # the other process asks for itself
        "import resource; resource.setrlimit(resource.RLIMIT_CPU, (1, 1))"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    path = tmp_path / "a.blf"
    blf(path, struct.pack("<4sHHII", b"LOBJ", 32, 9, 0, 1) + bytes(32))  # it has no size
    log = LogFile(path)
    assert len(list(log.frames())) == 1
    assert log.problem == f"{path}: broken after 1 frames: takes more than 1 s to read"


def test_a_training_that_unpacks_to_too_much(tmp_path, monkeypatch):
    path = tmp_path / "w.npz"
    np.savez_compressed(path, settings=np.array("x"), weights=np.zeros(1 << 20))
    assert len(checkpoint.load_checkpoint(path, "x")["weights"]) == 1 << 20
    monkeypatch.setattr(checkpoint, "MOST_BYTES", 1 << 20)
    with pytest.raises(InputError, match="too large"):
        checkpoint.load_checkpoint(path, "x")


def test_metadata_of_many_values_is_refused_early(tmp_path):
    """1 MB of empty lists took 15 s and 345 MB."""
    path = tmp_path / "metadata.yaml"
    path.write_text(f"{INFORMATION}: [{'[],' * (MOST_METADATA // 4)}[]]\n")
    with pytest.raises(InputError, match=r"metadata\.yaml:1: not YAML: over \d+ values"):
        load_plain(path, "metadata", MOST_METADATA)
