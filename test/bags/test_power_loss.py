"""Power that is cut at any instant: what a journaling file system may then hold is still of use.

Every fsync, renaming and flush of the writers is an instant. Of what was not synced the disk holds
nothing, zeros, or all; of renamed, new and removed names those at the last sync of the folder, or
those of now.
"""

from collections.abc import Iterator
from itertools import pairwise
import os
from pathlib import Path

import pytest

from evpinn_ros.bags import writer
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import new_message
from evpinn_ros.bags.writer import BagWriter, Split
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.estimation.state_file import read_state, write_state
from evpinn_ros.topics.messages import scalar

pytestmark = pytest.mark.slow

MILLI = 1_000_000


class Disk:
    """What is durable of the files of a folder; `states` makes what a loss of power leaves."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self._copies = folder, 0
        self._names: dict[str, int] = {}  # durable entries of the folder
        self._synced: dict[int, bytes] = {}  # durable content by inode
        self._newest: dict[int, bytes] = {}
        self._instant = lambda: None
        sync, replace = os.fsync, Path.replace

        def synced(handle: int) -> None:
            self._instant()
            sync(handle)
            self._sync(handle)
            self._instant()

        def replaced(source: Path, target: Path) -> Path:
            self._instant()
            renamed = replace(source, target)
            self._instant()
            return renamed

        monkeypatch.setattr(os, "fsync", synced)
        monkeypatch.setattr(Path, "replace", replaced)

    def at_every_instant(self, look) -> None:
        """Look at every state of the disk, at each instant from now on."""

        def instant() -> None:
            for state in self.states():
                look(state)

        self._instant = instant

    def _sync(self, handle: int) -> None:
        link = Path(f"/proc/self/fd/{handle}")
        if link.readlink() == self.folder:
            self._names = {name: inode for name, (inode, _) in self._now().items()}
        elif link.readlink().parent == self.folder:
            inode = os.fstat(handle).st_ino
            self._synced[inode] = self._newest[inode] = link.read_bytes()

    def _now(self) -> dict[str, tuple[int, bytes]]:
        """Inode and content of every name, as they are at one moment: others write meanwhile."""
        while True:
            names = self._names_now()
            contents = {}
            try:
                for name in names:
                    with (self.folder / name).open("rb") as file:
                        contents[name] = os.fstat(file.fileno()).st_ino, file.read()
            except FileNotFoundError:
                continue  # renamed since it was listed
            if names == self._names_now():
                return contents

    def _names_now(self) -> list[str]:
        there = self.folder.exists()
        return sorted(path.name for path in self.folder.iterdir()) if there else []

    def states(self) -> Iterator[Path]:
        now = self._now()
        self._newest |= dict(now.values())
        there = {name: inode for name, (inode, _) in now.items()}
        seen: list[dict[str, bytes]] = []
        for names in (self._names, there):
            for fate in ("missing", "zeros", "there"):
                contents = {name: self._content(inode, fate) for name, inode in names.items()}
                if contents not in seen:
                    seen.append(contents)
                    yield self._copy(contents)

    def _content(self, inode: int, fate: str) -> bytes:
        synced, newest = self._synced.get(inode, b""), self._newest[inode]
        left = {"missing": b"", "zeros": bytes(len(newest)), "there": newest}[fate]
        return synced + left[len(synced) :]

    def _copy(self, contents: dict[str, bytes]) -> Path:
        self._copies += 1
        copy = self.folder.parent / f"after_{self._copies}" / self.folder.name
        copy.mkdir(parents=True)
        for name, content in contents.items():
            (copy / name).write_bytes(content)
        return copy


def test_a_state_is_the_old_one_or_the_new_one_and_once_saved_the_new_one(tmp_path, monkeypatch):
    disk = Disk(tmp_path / "disk", monkeypatch)
    path, states = disk.folder / "car.json", [None, {"a": 1}, {"b": [2.5] * 5000}, {"c": "x"}]
    looks = 0
    for old, new in pairwise(states):

        def look(copy: Path, either=(old, new)) -> None:
            nonlocal looks
            looks += 1
            assert read_state(copy / path.name) in either

        disk.at_every_instant(look)
        write_state(path, new)
        for copy in disk.states():
            assert read_state(copy / path.name) == new
    assert looks >= 3 * 6


@pytest.mark.parametrize("split", [None, Split(seconds=1.5)])
def test_a_recording_loses_its_last_second_at_most(tmp_path, monkeypatch, split):
    monkeypatch.setattr(writer, "SYNC_SECONDS", 0.0)
    disk = Disk(tmp_path / "bag", monkeypatch)
    written: list[int] = []
    lost: list[str] = []  # an assertion in the thread that syncs would be lost as well
    looks = 0

    def look(copy: Path) -> None:
        nonlocal looks
        looks += 1
        try:
            with BagReader(copy) as bag:
                times_ns = [record.log_time_ns for record in bag.records()]
        except InputError:
            times_ns = []
        wanted = [time for time in written if time <= written[-1] - 1000 * MILLI]
        if times_ns[: len(wanted)] != wanted or times_ns != written[: len(times_ns)]:
            lost.append(f"{copy}: {len(times_ns)} of {len(written)}, {len(wanted)} were wanted")

    with BagWriter(disk.folder, live=True, split=split) as bag:
        disk.at_every_instant(look)
        for tick in range(60):
            time_ns = (tick + 1) * 50 * MILLI
            topic = f"/topic_{tick // 25}"  # new topics on the way
            bag.write(topic, scalar(new_message, float(tick)), time_ns)
            written.append(time_ns)
            if tick % 10 == 9:  # twice a second, as the recorder does
                bag.flush()
                bag._part._syncing.join()
        for copy in disk.states():
            look(copy)
    assert looks > 60 and not lost, lost
