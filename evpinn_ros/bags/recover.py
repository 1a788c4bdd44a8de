"""`evpinn recover`: what a broken bag still holds, as a new bag, and what was lost."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import (
    Attachment,
    Channel,
    Metadata,
)

from evpinn_ros.bags.mcap_copy import McapCopy
from evpinn_ros.bags.metadata import (
    METADATA,
    WrittenFile,
    WrittenTopic,
    as_yaml,
    bag_information,
    write_metadata,
)
from evpinn_ros.bags.salvage import Loss, Piece, Salvage
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import FileBytes
from evpinn_ros.common.yaml_section import plain_text

MOST_LOSSES = 1000  # kept one by one; beyond, only their sum
LONGEST_QOS = 10_000  # characters of YAML that are read
ROSBAG2 = "rosbag2"  # metadata that is written anew

Progress = Callable[[int], None]  # takes bytes of the file done


@dataclass(slots=True)
class RecoveredFile:
    """Yield of one file."""

    path: Path  # of the broken file
    size: int = 0  # of it, bytes
    messages: int = 0  # saved
    unproven: int = 0  # those of them that no checksum covers
    chunks: int = 0  # saved as they were packed
    stated: int | None = None  # messages that the file says it held, None when it does not say
    ended: bool = False  # it has its end and index
    unknown_topic: int = 0  # messages left out, since the definition of their topic is lost
    doubtful_topics: tuple[str, ...] = ()  # whose definition comes from a damaged chunk
    start_ns: int = 0  # first log time saved; zero without a message
    end_ns: int = 0  # last log time saved
    losses: list[Loss] = field(default_factory=list)  # the first `MOST_LOSSES` of them, in order
    more_losses: int = 0  # those beyond
    lost_bytes: int = 0  # of all losses
    problem: str | None = None  # why it could not be read, or not to its end; None if it could

    @property
    def lost_chunks(self) -> int:
        """Chunks that were damaged, cut or refused."""
        return sum(loss.chunk for loss in self.losses)

    @property
    def lost_messages(self) -> int | None:
        """Messages not saved; None when the file does not tell."""
        if self.stated is not None:
            return max(0, self.stated - self.messages)
        known = [loss.messages for loss in self.losses]
        if self.problem or self.more_losses or None in known:
            return None
        return sum(count or 0 for count in known) + self.unknown_topic

    @property
    def whole(self) -> bool:
        """Nothing was lost but, perhaps, the index."""
        lost = self.more_losses or any(loss.messages != 0 for loss in self.losses)
        return not (lost or self.unknown_topic or self.problem)


def recover(source: Path, out: Path, progress: Progress = lambda _: None) -> list[RecoveredFile]:
    """Save what a broken MCAP file, or a folder of them, still holds as a new bag.

    A file that cannot be read stops no other. Interrupted, or where the disk is full, it leaves
    nothing behind.

    `source` is an MCAP file or a rosbag2 folder, with or without metadata.yaml; `out` a folder
    that is not there, or empty. `progress` takes the bytes done, of all files together.

    Raises:
        InputError: no MCAP there, `out` is in use, or no message could be saved.
        OSError: `out` cannot be written.
    """
    paths = broken_files(source)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: in use; give the name of a new folder")
    out.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    try:
        found = _recover_files(paths, out, files, progress)
        if not files:
            raise InputError(_nothing(source, found))
        return found
    except (InputError, OSError, KeyboardInterrupt):
        for path in (*files, out / METADATA):
            path.unlink(missing_ok=True)
        with suppress(OSError):  # not empty: somebody else writes there too
            out.rmdir()
        raise


def _recover_files(
    paths: list[Path], out: Path, files: list[Path], progress: Progress
) -> list[RecoveredFile]:
    """Save each of them; `files` are those that were made."""
    found: list[RecoveredFile] = []
    topics: dict[str, WrittenTopic] = {}
    written: list[WrittenFile] = []
    for path in paths:
        copy = McapCopy(out / f"{out.resolve().name}_{len(files)}.mcap")
        files.append(copy.path)
        before = sum(each.size for each in found)
        try:
            found.append(_recover_file(path, copy, topics, progress, before))
        finally:
            copy.close()
        if copy.written.count:
            written.append(copy.written)
        else:
            files.pop().unlink()
    if files:
        write_metadata(out, bag_information(written, topics.values()))
    return found


def _nothing(source: Path, found: list[RecoveredFile]) -> str:
    """Reason why there is no message at all."""
    for one in found:
        if one.problem is not None:
            return one.problem
    empty = not any(one.size for one in found)
    return f"{source}: {'the file is empty' if empty else 'no message could be saved'}"


def broken_files(source: Path) -> list[Path]:
    """The MCAP files of a bag, in the order of their numbers.

    Raises:
        InputError: there is none.
    """
    if not source.exists():
        raise InputError(f"{source}: no such file or folder")
    if source.is_file():
        return [source]
    if not source.is_dir():
        raise InputError(f"{source}: neither a file nor a folder")
    paths = [path for path in source.glob("*.mcap") if path.is_file()]
    if not paths:
        known = (
            "sqlite3 bags are saved by: sqlite3 BAG.db3 .recover"
            if any(source.glob("*.db3"))
            else "give the folder of a rosbag2 bag, or an MCAP file"
        )
        raise InputError(f"{source}: no .mcap file in this folder; {known}")
    return sorted(paths, key=lambda path: (_number(path), path.name))


def _number(path: Path) -> int:
    """Number of one file of a bag: drive_10.mcap comes after drive_9.mcap."""
    digits = path.stem.rpartition("_")[2]
    return int(digits) if digits.isascii() and digits.isdigit() else -1


def _recover_file(
    path: Path, copy: McapCopy, topics: dict[str, WrittenTopic], progress: Progress, before: int
) -> RecoveredFile:
    one = RecoveredFile(path)
    try:
        file = FileBytes(path)
    except InputError as error:
        one.problem = str(error)
        return one
    with closing(file):
        one.size = file.size
        salvage = Salvage(file)
        try:
            for done in _save_all(salvage, one, copy):
                progress(before + done)
        except InputError as error:
            one.problem = str(error)
        one.stated, one.ended = salvage.stated, salvage.ended
        one.unknown_topic = salvage.unknown
        one.doubtful_topics = tuple(sorted(salvage.doubtful))
        one.messages = copy.written.count
        one.start_ns, one.end_ns = copy.written.start_ns, copy.written.end_ns
        for id_ in sorted(copy.counts):
            _count_topic(topics, salvage, id_, copy.counts[id_])
        information = bag_information([copy.written], topics.values())
        copy.note(Metadata(ROSBAG2, {"serialized_metadata": as_yaml(information)}))
        copy.finish(salvage.definitions)
        return one


def _save_all(salvage: Salvage, one: RecoveredFile, copy: McapCopy) -> Iterator[int]:
    """Save what there is; gives the bytes done."""
    unended: list[Loss] = []
    for each in salvage:
        if isinstance(each, Loss):
            each.after_ns = copy.written.end_ns if copy.written.count else None
            _note_loss(one, each, unended)
            yield each.end
        elif isinstance(each, Piece):
            _save(one, each, copy, salvage, unended)
            yield each.end
        elif isinstance(each, Attachment):
            copy.attach(each)
        elif isinstance(each, Metadata) and each.name != ROSBAG2:
            copy.note(each)


def _save(
    one: RecoveredFile, piece: Piece, copy: McapCopy, salvage: Salvage, unended: list[Loss]
) -> None:
    if not piece.found.count:
        return
    if piece.packed is not None and piece.block.head is not None:
        copy.copy(piece.block.head, piece.packed, piece.found, salvage.definitions)
        one.chunks += 1
    else:
        copy.pack(piece.content, piece.found, salvage.definitions)
    for loss in unended:
        loss.before_ns = piece.found.span_ns[0]
    unended.clear()
    one.unproven += 0 if piece.proven else piece.found.count


def _note_loss(one: RecoveredFile, loss: Loss, unended: list[Loss]) -> None:
    one.lost_bytes += loss.end - loss.begin
    if len(one.losses) == MOST_LOSSES:
        one.more_losses += 1
        return
    one.losses.append(loss)
    unended.append(loss)


def _count_topic(
    topics: dict[str, WrittenTopic], salvage: Salvage, channel_id: int, count: int
) -> None:
    known = salvage.definitions
    channel = known.channels[channel_id]
    if channel.topic not in topics:
        type_name = known.schemas[channel.schema_id].name if channel.schema_id else ""
        type_hash = channel.metadata.get("topic_type_hash", "")
        topics[channel.topic] = WrittenTopic(channel.topic, type_name, type_hash, _qos(channel))
    topics[channel.topic].count += count


def _qos(channel: Channel) -> list[dict[str, Any]]:
    """Offered quality of service, as in the file: rosbags reads a topic only if both agree."""
    text = channel.metadata.get("offered_qos_profiles", "")
    if len(text) > LONGEST_QOS:
        return []
    try:
        found = plain_text(text)
    except ValueError:
        return []
    whole = isinstance(found, list) and all(isinstance(each, dict) for each in found)
    return found if whole else []
