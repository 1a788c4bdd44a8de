"""Our own reader of MCAP files against what `recover` saves: they find the same, always."""

from pathlib import Path
import random
import struct

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
import pytest

from evpinn_ros.bags import mcap_file, salvage
from evpinn_ros.bags.mcap_file import McapFile
from evpinn_ros.bags.recover import recover
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.units import MEBIBYTE
from test.bags.broken import STORAGES, chunks_of, messages_of

pytestmark = pytest.mark.slow

START = 1_700_000_000_000_000_000


def messages_in(path: Path) -> list[tuple[str, int, bytes]]:
    """Topic, log time and data of what our own reader finds, in its order of equal times."""
    file = McapFile(path)
    found = [
        (file.channels[id_].topic, at, data) for at, id_, data in file.messages(file.channels)
    ]
    file.close()
    return found


DAMAGES = {
    "cut": lambda data, at, noise: data[:at],
    "flipped": lambda data, at, noise: data[:at] + bytes((data[at] ^ 255,)) + data[at + 1 :],
    "overwritten": lambda data, at, noise: data[:at] + noise + data[at + len(noise) :],
    "missing": lambda data, at, noise: data[:at] + data[at + len(noise) :],
    "inserted": lambda data, at, noise: data[:at] + noise + data[at:],
}


@settings(
    max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.sampled_from(STORAGES),
    st.lists(
        st.tuples(st.sampled_from(sorted(DAMAGES)), st.floats(0, 1), st.binary(min_size=1)),
        min_size=1,
        max_size=3,
    ),
)
def test_the_reader_finds_what_recover_saves(wholes, tmp_path_factory, storage, damages):
    folder = tmp_path_factory.mktemp("same")
    data = wholes[storage].read_bytes()
    for kind, share, noise in damages:
        data = DAMAGES[kind](data, min(8 + int(share * len(data)), len(data) - 1), noise)
    data = wholes[storage].read_bytes()[:8] + data[8:]
    (folder / "broken.mcap").write_bytes(data)
    read = messages_in(folder / "broken.mcap")
    try:
        recover(folder / "broken.mcap", folder / "new")
    except InputError:
        assert not read
        return
    assert sorted(read) == sorted(messages_in(folder / "new" / "new_0.mcap"))


def test_a_wrong_length_of_a_chunk_costs_the_reader_no_more_than_recover(wholes, tmp_path):
    path = wholes["zstd"]
    hit, data = chunks_of(path)[1], bytearray(path.read_bytes())
    struct.pack_into("<Q", data, hit.chunk_start_offset + 1, hit.chunk_length + 1000)
    (tmp_path / "broken.mcap").write_bytes(data)
    recover(tmp_path / "broken.mcap", tmp_path / "new")
    read = messages_in(tmp_path / "broken.mcap")
    assert sorted(read) == sorted(messages_in(tmp_path / "new" / "new_0.mcap"))
    assert len(read) > 0.6 * len(messages_of(path))


@pytest.mark.parametrize("size", [3 * MEBIBYTE, 4 * MEBIBYTE + 1000])
def test_a_long_chunk_is_saved_and_read_or_neither(tmp_path, monkeypatch, size):
    for module in (salvage, mcap_file):
        monkeypatch.setattr(module, "LONGEST_CHUNK", 4 * MEBIBYTE)
    noise = random.Random(1).randbytes(MEBIBYTE) * (size // MEBIBYTE)
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/a", "cdr", schema)
        writer.add_message(channel, START, b"small", START)
        writer.flush()
        writer.add_message(channel, START + 1, noise, START + 1)
        writer.finish()
    (report,) = recover(tmp_path / "a.mcap", tmp_path / "new")
    count = 1 + (size <= 3 * MEBIBYTE)
    assert report.messages == count
    assert len(messages_in(tmp_path / "a.mcap")) == count
    assert len(messages_in(tmp_path / "new" / "new_0.mcap")) == count
