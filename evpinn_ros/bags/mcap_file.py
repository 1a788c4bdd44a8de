"""Reads an MCAP file in log time order: by rosbags if intact, else in two passes over it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterator, Mapping
from contextlib import suppress
import heapq
from itertools import islice
from pathlib import Path

from mcap.records import Message

from evpinn_ros.bags.channel import Channel, RawMessage, parsed_qos, plain_qos
from evpinn_ros.bags.limits import MOST_HELD
from evpinn_ros.bags.mcap_records import MAGIC, Loss, McapRecords
from evpinn_ros.bags.rosbags_file import RosbagsFile
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import open_file

OVERLAP = "chunks overlap too far, so some messages are not in order of log time"
QOS, TYPE_HASH = "offered_qos_profiles", "topic_type_hash"  # in the metadata of a channel
OVERHEAD = 250  # bytes of a Python message besides its data


class McapFile:
    """An open MCAP file."""

    def __init__(self, path: Path) -> None:
        """Find the channels and the messages; InputError if the file is not MCAP."""
        self.path = path
        self.notes: list[str] = []  # always empty: the format has no companion files
        with as_input_error(path):
            self._file = open_file(path)
        self._damage: list[str] = []
        self._indexed: RosbagsFile | None = None
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    @property
    def problem(self) -> str | None:
        """Damage and losses, in one line. Complete once every message was read."""
        if not self._damage:
            return None
        return f"{self.path}: {'; '.join(self._damage)}; {self._readable} messages are readable"

    def messages(self, wanted: Container[int]) -> Iterator[RawMessage]:
        """The messages of the wanted channel ids in log time order; equal times in file order."""
        read = 0
        if self._indexed is not None:
            for message in self._indexed.messages(wanted):
                yield message
                read += 1
            if self._indexed.problem is None:
                return
            self._indexed.close()
            self._indexed = None
            self._survey()  # a chunk is damaged; the messages before it are skipped below
        yield from islice(self._in_order(wanted), read, None)

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        if self._indexed is not None:
            self._indexed.close()
            self._indexed = None
        self._file.close()

    def _open(self) -> None:
        with as_input_error(self.path):
            begin = self._file.read(len(MAGIC))
        if begin != MAGIC:
            what = "not an MCAP file" if begin else "the file is empty"
            raise InputError(f"{self.path}: {what}")
        records = McapRecords(self._file, self.path)
        summary = records.summary
        channels = summary.content.channels.values()
        plain = all(plain_qos(channel.metadata.get(QOS, "")) for channel in channels)
        if plain and summary.indexes_all and summary.within_limits(records.size):
            with suppress(InputError):  # for example, if the profile is not ROS 2
                self._indexed = RosbagsFile(self.path)
        if self._indexed is not None:
            self.channels: Mapping[int, Channel] = self._indexed.channels
            self.counts: Mapping[int, int] = self._indexed.counts  # messages by channel id
        else:
            self._survey()

    def _survey(self) -> None:
        records, counts, losses = McapRecords(self._file, self.path), Counter[int](), list[Loss]()
        damage: list[str] = []
        try:
            for item in records:
                if isinstance(item, Message):
                    counts[item.channel_id] += 1
                elif isinstance(item, Loss):
                    losses.append(item)
        except InputError as error:  # a bad sector: records before it can be read
            damage.append(str(error))
        self.counts, self._readable = counts, counts.total()
        self.channels = _channels(records)  # by channel id
        losses = [loss for loss in losses if loss.messages != 0]
        if losses:
            first = losses[0]
            damage.append(
                f"cut or damaged at byte {first.begin} of {records.size}: {first.reason}"
            )
        elif not records.ended:
            damage.append("the end of the file is missing")
        if records.unknown:
            damage.append(f"the topics of {records.unknown} messages are lost")
        if lost_chunks := sum(loss.chunk for loss in losses):
            damage.append(f"{lost_chunks} of {records.chunks} chunks are damaged")
        if not records.unknown and (records.stated or 0) > self._readable:
            damage.append(f"{(records.stated or 0) - self._readable} messages lost")
        self._damage = damage

    def _in_order(self, wanted: Container[int]) -> Iterator[RawMessage]:
        """The messages in log time order, as far as `MOST_HELD` bytes allow."""
        waiting: list[tuple[int, int, int, bytes]] = []
        held = newest_ns = 0
        for number, message in enumerate(self._wanted(wanted)):
            entry = (message.log_time, number, message.channel_id, message.data)
            heapq.heappush(waiting, entry)
            held += OVERHEAD + len(message.data)
            while held > MOST_HELD:
                log_time_ns, _, channel, data = heapq.heappop(waiting)
                held -= OVERHEAD + len(data)
                if log_time_ns < newest_ns and OVERLAP not in self._damage:
                    self._damage.append(OVERLAP)
                newest_ns = max(newest_ns, log_time_ns)
                yield log_time_ns, channel, data
        while waiting:
            log_time_ns, _, channel, data = heapq.heappop(waiting)
            yield log_time_ns, channel, data

    def _wanted(self, wanted: Container[int]) -> Iterator[Message]:
        with suppress(InputError):  # a bad sector, noted by `_survey`
            for item in McapRecords(self._file, self.path):
                if isinstance(item, Message) and item.channel_id in wanted:
                    yield item


def _channels(records: McapRecords) -> dict[int, Channel]:
    """Channels by id, without channels whose schema is lost."""
    schemas = {0: ("", "")} | {
        id_: (schema.name, schema.data.decode(errors="replace"))
        for id_, schema in records.schemas.items()
    }
    return {
        id_: Channel(
            channel.topic,
            schemas[channel.schema_id][0],
            channel.message_encoding,
            schemas[channel.schema_id][1],
            channel.metadata.get(TYPE_HASH, ""),
            parsed_qos(channel.metadata.get(QOS, "")),
        )
        for id_, channel in records.channels.items()
        if channel.schema_id in schemas
    }
