"""Broken MCAP files saved, against the whole ones."""

import errno
import io
import os
from pathlib import Path
import random
import struct

from mcap.reader import make_reader
from mcap.writer import Writer
import pytest
from rosbags.rosbag2 import Reader
from typer.testing import CliRunner
import yaml

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.recover import recover
from evpinn_ros.bags.types import encode, new_message
from evpinn_ros.bags.writer import BagWriter, Split
from evpinn_ros.cli.main import app
from evpinn_ros.common.errors import InputError
from evpinn_ros.topics.messages import scalar
from test.bags.broken import FAULTS, STORAGES, blocks_of, chunks_of, damaged, messages_of

pytestmark = pytest.mark.slow

START = 1_700_000_000_000_000_000
STEP = 100_000_000


def saved(folder: Path, data: bytes):
    """The report and the messages of a recovery, read by rosbags as well."""
    (folder / "broken.mcap").write_bytes(data)
    (report,) = recover(folder / "broken.mcap", folder / "new")
    messages = messages_of(folder / "new" / "new_0.mcap")
    with Reader(folder / "new") as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count == len(messages)
    assert report.messages == len(messages)
    return report, messages


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("storage", STORAGES)
def test_every_message_of_undamaged_chunks_comes_back(wholes, tmp_path, storage, fault):
    data, blocks = wholes[storage].read_bytes(), blocks_of(wholes[storage], storage == "loose")
    whole, chance = {message for block in blocks for message in block.messages}, random.Random(0)
    for number in range(2):
        broken, begin, end = damaged(data, fault, chance)
        (folder := tmp_path / str(number)).mkdir()
        _, messages = saved(folder, broken)
        sound = [block for block in blocks if block.end <= begin or block.begin >= end]
        assert {message for block in sound for message in block.messages} <= {*messages}
        assert len({*messages}) == len(messages)
        # No checksum covers the message that was hit where it is in no chunk.
        assert len({*messages} - whole) <= (storage == "loose" and fault == "bit flipped")


@pytest.mark.parametrize("storage", STORAGES)
def test_a_whole_file_comes_back_whole(wholes, tmp_path, storage):
    report, messages = saved(tmp_path, wholes[storage].read_bytes())
    assert messages == messages_of(wholes[storage])
    assert report.whole and report.ended and report.lost_messages == 0
    assert report.unproven == (report.messages if storage == "loose" else 0)


def test_only_the_damaged_chunk_is_lost_and_told(wholes, tmp_path):
    path = wholes["zstd"]
    chunks, data = chunks_of(path), bytearray(path.read_bytes())
    hit = chunks[2]
    data[hit.chunk_start_offset + hit.chunk_length // 2] ^= 1
    report, messages = saved(tmp_path, bytes(data))
    whole = messages_of(path)
    times = range(hit.message_start_time, hit.message_end_time + 1)
    assert messages == [message for message in whole if message[1] not in times]
    (loss,) = report.losses
    assert (loss.begin, loss.end) == (
        hit.chunk_start_offset,
        hit.chunk_start_offset + hit.chunk_length,
    )
    assert loss.messages == report.lost_messages == len(whole) - len(messages)
    assert (loss.after_ns, loss.before_ns) == (
        chunks[1].message_end_time,
        chunks[3].message_start_time,
    )


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("hole", [bytes(512), b"", b"\x05\x16\0\0" * 300])
def test_bytes_that_are_overwritten_missing_or_inserted(wholes, tmp_path, storage, hole):
    """What is before them is saved; what is behind them as well where the index leads there."""
    data, whole = wholes[storage].read_bytes(), messages_of(wholes[storage])
    report, messages = saved(tmp_path, data[:50_000] + hole + data[50_512:])
    assert not report.whole and messages[0] == whole[0]
    altered = len(set(messages) - set(whole))
    assert altered <= (storage == "loose")  # no checksum covers the message that was hit
    if len(hole) == 512 and storage != "loose":
        assert 0.6 * len(whole) < len(messages) < len(whole) and messages[-1] == whole[-1]
    else:
        assert 0.2 * len(whole) < len(messages) < len(whole)
        assert messages[:-1] == whole[: len(messages) - 1]


def test_topics_whose_definition_was_in_the_lost_chunk(wholes, tmp_path):
    """The index at the end has it too; without that their messages are counted as lost."""
    path = wholes["chunks"]
    first, data = chunks_of(path)[0], bytearray(path.read_bytes())
    data[first.chunk_start_offset + first.chunk_length - 3] ^= 1
    sound = [m for m in messages_of(path) if m[1] > first.message_end_time]
    report, messages = saved(tmp_path, bytes(data))
    assert messages == sound and not report.unknown_topic
    (tmp_path / "broken.mcap").write_bytes(data[:-10])
    with BagReader(tmp_path / "broken.mcap") as reader:
        assert not list(reader.raw_records())
        assert f"the topics of {len(sound)} messages are lost" in reader.problem


@pytest.mark.parametrize("size", [0, 3, 1 << 40])
def test_a_chunk_that_lies_about_its_size_is_refused(wholes, tmp_path, size):
    path = wholes["zstd"]
    hit, data = chunks_of(path)[1], bytearray(path.read_bytes())
    struct.pack_into("<Q", data, hit.chunk_start_offset + 9 + 16, size)
    report, messages = saved(tmp_path, bytes(data))
    assert len(report.losses) == 1 and len(messages) > 0.6 * len(messages_of(path))


def test_attachments_and_metadata_are_kept(tmp_path):
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="")
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data")
        channel = writer.register_channel("/a", "cdr", schema)
        writer.add_message(channel, START, encode(scalar(new_message, 1.0)), START)
        writer.add_attachment(START, START, "map.txt", "text/plain", b"here" * 100)
        writer.add_metadata("car", {"name": "it"})
        writer.finish()
    saved(tmp_path, (tmp_path / "a.mcap").read_bytes()[:-20])
    with (tmp_path / "new" / "new_0.mcap").open("rb") as file:
        reader = make_reader(file)
        assert [a.data for a in reader.iter_attachments()] == [b"here" * 100]
        assert {m.name: m.metadata for m in reader.iter_metadata()}["car"] == {"name": "it"}
        assert reader.get_summary().statistics.attachment_count == 1


def bag_of_three(folder: Path) -> Path:
    with BagWriter(folder, split=Split(seconds=10.0)) as writer:
        for i in range(300):
            message = new_message("geometry_msgs/msg/TwistStamped")
            writer.write("/other", message, START + i * STEP)
            writer.write("/ev/battery/voltage", scalar(new_message, i), START + i * STEP)
    return folder


def test_a_folder_without_metadata_and_with_a_broken_file(tmp_path):
    bag = bag_of_three(tmp_path / "bag")
    (bag / "metadata.yaml").unlink()
    last = bag / "bag_2.mcap"
    last.write_bytes(last.read_bytes()[: last.stat().st_size * 2 // 5])
    first, _, third = recover(bag, tmp_path / "new")
    assert first.whole and not third.ended and 400 < 400 + third.messages < 600
    with Reader(tmp_path / "new") as reader:
        assert reader.message_count == 400 + third.messages == sum(1 for _ in reader.messages())
    with BagReader(tmp_path / "new") as reader:
        values = [record.message.data for record in reader.records(["/ev/battery/voltage"])]
        assert values == list(range(len(values))) and reader.problem is None
    information = yaml.safe_load((tmp_path / "new" / "metadata.yaml").read_text())
    files = information["rosbag2_bagfile_information"]["files"]
    assert [file["path"] for file in files] == ["new_0.mcap", "new_1.mcap", "new_2.mcap"]
    assert [file["message_count"] for file in files] == [200, 200, third.messages]


def read_fails(monkeypatch, path: Path, from_byte: int) -> None:
    """The disk gives an error where this file is read from this byte on, as a bad sector does."""

    class BadSector(io.FileIO):
        def readinto(self, buffer) -> int:
            if self.tell() >= from_byte:
                raise OSError(errno.EIO, "Input/output error")
            # The kernel gives what is before it.
            data = self.read(min(len(buffer), from_byte - self.tell()))
            buffer[: len(data)] = data
            return len(data)

    def opened(asked: Path) -> io.BufferedReader:
        return io.BufferedReader(BadSector(asked) if asked == path else io.FileIO(asked))

    monkeypatch.setattr("evpinn_ros.bags.recover.open_file", opened)


def test_a_file_that_cannot_be_read_stops_no_other(tmp_path, monkeypatch):
    bag = bag_of_three(tmp_path / "bag")
    read_fails(monkeypatch, bag / "bag_1.mcap", 0)
    first, second, third = recover(bag, tmp_path / "new")
    assert first.whole and third.whole and third.messages == 200
    assert (second.messages, second.whole, second.lost_messages) == (0, False, None)
    assert "bag_1.mcap: Input/output error" in second.problem
    with Reader(tmp_path / "new") as reader:
        assert reader.message_count == 400 == sum(1 for _ in reader.messages())
    ended = CliRunner().invoke(app, ["recover", str(bag), str(tmp_path / "told")])
    assert ended.exit_code == 1 and "1 of 3 files could not be read" in ended.output
    with pytest.raises(InputError, match="Input/output error"):
        recover(bag / "bag_1.mcap", tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_what_is_before_a_bad_sector_is_saved(tmp_path, monkeypatch):
    bag = bag_of_three(tmp_path / "bag")
    read_fails(monkeypatch, bag / "bag_1.mcap", (bag / "bag_1.mcap").stat().st_size // 2)
    second = recover(bag, tmp_path / "new")[1]
    assert second.messages > 50 and not second.whole and "Input/output error" in second.problem


def test_stopped_it_leaves_nothing(tmp_path):
    bag = bag_of_three(tmp_path / "bag")
    size = (bag / "bag_0.mcap").stat().st_size

    def stop(done: int) -> None:
        if done > size:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        recover(bag, tmp_path / "new", stop)
    assert not (tmp_path / "new").exists()
    assert len(recover(bag, tmp_path / "new")) == 3, "the same command goes"


WRONG = [
    (None, "no such file"),
    (b"", "the file is empty"),
    (b"\x05\x16\0\0\0\0\0\0\0" * 10_000, "no message could be saved"),
]


@pytest.mark.parametrize(("content", "reason"), WRONG)
def test_what_holds_nothing_is_refused_in_one_line(tmp_path, content, reason):
    path = tmp_path / "a.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=reason) as caught:
        recover(path, tmp_path / "new")
    assert "a.mcap" in str(caught.value) and "\n" not in str(caught.value)
    assert not (tmp_path / "new").exists()


def test_nothing_is_overwritten(wholes, tmp_path):
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "mine.txt").write_text("")
    with pytest.raises(InputError, match="not empty"):
        recover(wholes["zstd"], tmp_path / "new")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"no \.mcap file in this folder"):
        recover(tmp_path / "empty", tmp_path / "other")


def test_records_of_other_programs_are_skipped(wholes, tmp_path):
    data, chunks = wholes["zstd"].read_bytes(), chunks_of(wholes["zstd"])
    own = b"\x80" + struct.pack("<Q", 5) + b"whose"
    at = chunks[1].chunk_start_offset
    report, messages = saved(tmp_path, data[:at] + own + data[at:])
    assert report.losses == [] and messages == messages_of(wholes["zstd"])


def test_a_disk_that_is_full_at_the_last_file_is_left_as_it_was(wholes, tmp_path, monkeypatch):
    """The messages have room, metadata.yaml has not: no folder without it stays."""

    def full(path, text):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("evpinn_ros.bags.metadata.write_file", full)
    with pytest.raises(OSError, match="No space left"):
        recover(wholes["zstd"], tmp_path / "new")
    assert not any(tmp_path.iterdir())
