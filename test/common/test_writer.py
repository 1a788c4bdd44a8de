"""A file is whole or not there, whatever ends its writing."""

import ast
import ctypes
import errno
import os
from pathlib import Path
import re
import resource
import signal
import subprocess
import sys

import pytest

from evpinn_ros.common import writer
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.writer import DRAFT, Held, check_outputs, claimed, replaced
from evpinn_ros.core.estimation import state_file
from evpinn_ros.core.estimation.state_file import Half, read_state, write_halves


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("end", [OSError(errno.ENOSPC, "full"), ValueError(), KeyboardInterrupt()])
@pytest.mark.parametrize("before", [None, "old"])
def test_what_is_not_whole_leaves_nothing(tmp_path, end, before):
    path = tmp_path / "car.json"
    if before is not None:
        path.write_text(before)

    def write():
        with replaced(path) as draft:
            draft.write(b"half")
            raise end

    with pytest.raises(type(end)):
        write()
    assert names(tmp_path) == ([] if before is None else ["car.json"])
    assert before is None or path.read_text() == before


def test_a_link_goes_on_to_lead_to_the_file(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link.json").symlink_to(tmp_path / "real" / "car.json")
    with replaced(tmp_path / "link.json") as draft:
        draft.write(b"new")
    assert (tmp_path / "link.json").is_symlink()
    assert (tmp_path / "real" / "car.json").read_text() == "new"
    assert names(tmp_path / "real") == ["car.json"]


def test_a_device_is_written_to_and_stays_one(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reading = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    with replaced(tmp_path / "pipe") as draft:
        draft.write(b"through")
    assert os.read(reading, 100) == b"through" and names(tmp_path) == ["pipe"]
    os.close(reading)


def test_a_link_at_a_draft_is_not_followed_and_a_file_like_one_is_kept(tmp_path):
    victim, path = tmp_path / "victim", tmp_path / "car.json"
    victim.write_text("precious")
    (tmp_path / "car.json.new").symlink_to(victim)
    (tmp_path / f"{DRAFT}link").symlink_to(victim)
    with replaced(path) as draft:
        draft.write(b"state")
    assert victim.read_text() == "precious" and path.read_text() == "state"
    assert (tmp_path / "car.json.new").is_symlink()
    (tmp_path / "car.json.new").unlink()
    (tmp_path / "car.json.new").write_text("mine")
    with replaced(path) as draft:
        draft.write(b"state")
    assert (tmp_path / "car.json.new").read_text() == "mine"


KILLED = """
import os, sys
from pathlib import Path
from evpinn_ros.common.writer import replaced
with replaced(Path(sys.argv[1])) as draft:
    draft.write(b"half")
    draft.flush()
    os._exit(9)
"""


def test_a_draft_of_a_killed_process_goes_and_that_of_a_living_one_stays(tmp_path):
    command = [sys.executable, "-c", KILLED, str(tmp_path / "zero")]
    assert subprocess.run(command, timeout=60).returncode == 9
    (dead,) = names(tmp_path)
    assert dead.startswith(DRAFT)
    with replaced(tmp_path / "one") as living:
        assert dead not in names(tmp_path) and len(names(tmp_path)) == 1
        with replaced(tmp_path / "two") as draft:
            draft.write(b"two")
        assert len(names(tmp_path)) == 2
        living.write(b"one")
    assert names(tmp_path) == ["one", "two"]


def test_a_draft_whose_writer_cannot_be_asked_for_stays_a_day(tmp_path):
    """Of another machine, or of an earlier version; its number may be that of a process here."""
    number = f"{os.getpid()}-{writer._start_of(os.getpid())}"
    ours, reused = f"{DRAFT}{writer._machine()}-{number}-a", f"{DRAFT}{writer._machine()}-1-2-a"
    others = [f"{DRAFT}0123abcd-{number}-a", f"{DRAFT}abcdefgh"]
    for name in (ours, reused, *others):
        (tmp_path / name).write_text("half")
    writer._sweep(tmp_path)
    assert names(tmp_path) == sorted([ours, *others])
    for name in (ours, *others):
        os.utime(tmp_path / name, (0, 0))
    writer._sweep(tmp_path)
    assert names(tmp_path) == [ours]


SAVER = """
import errno, fcntl, os, sys
from pathlib import Path
from evpinn_ros.common.writer import write_file
def no_lock(*_):
    raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))
if sys.argv[2] == "no locks":
    fcntl.flock = no_lock
for number in range(400):
    write_file(Path(sys.argv[1]), f"{number}" * 100)
"""


@pytest.mark.slow
@pytest.mark.parametrize("locks", ["locks", "no locks"])
def test_writers_of_one_folder_lose_no_draft_to_each_other(tmp_path, locks):
    processes = [
        subprocess.Popen([sys.executable, "-c", SAVER, str(tmp_path / name), locks])
        for name in ("a", "b", "c")
    ]
    assert [process.wait(timeout=300) for process in processes] == [0, 0, 0]
    assert names(tmp_path) == ["a", "b", "c"]


def test_a_lock_file_is_never_written_to(tmp_path):
    victim, lock = tmp_path / "victim", tmp_path / "lock"
    victim.write_text("precious")
    lock.symlink_to(victim)
    with pytest.raises(OSError, match="Too many levels"):
        Held(lock, "busy")
    lock.unlink()
    lock.hardlink_to(victim)
    with Held(lock, "busy"):
        with pytest.raises(InputError, match=r"^busy$"):
            Held(lock, "busy")
        assert victim.read_text() == "precious"
    assert names(tmp_path) == ["victim"] and victim.read_text() == "precious"


def test_a_mark_and_a_new_file_follow_no_link(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "victim")
    writer.mark(tmp_path / "link")
    for make in (writer.new_file, writer.new_table):
        with pytest.raises(FileExistsError):
            make(tmp_path / "link")
    assert names(tmp_path) == ["link"]


ROOT = Path(__file__).parents[2]
CREATES = {"touch", "write_text", "write_bytes", "mkstemp", "NamedTemporaryFile"}
CREATES |= {"copy2", "copyfile", "hardlink_to", "mkfifo"}


def creating(tree):
    """Calls that can create or empty a file by its name."""
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = getattr(call.func, "attr", getattr(call.func, "id", ""))
        text = ast.unparse(call)
        words = [*call.args, *(word.value for word in call.keywords)]
        modes = [word.value for word in words if isinstance(word, ast.Constant)]
        writes = any(re.fullmatch(r"[wax][+bt]*|r[bt]?\+[bt]?", str(mode)) for mode in modes)
        opens = name in ("open", "fdopen")
        copies = ast.unparse(call.func) in ("shutil.copy", "shutil.move")
        if (
            (opens and (writes or "O_CREAT" in text or "O_WRONLY" in text))
            or copies
            or name in CREATES
        ):
            yield call.lineno, text


def test_every_file_of_the_package_is_created_by_the_one_writer():
    beside = [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for path in sorted((ROOT / "evpinn_ros").rglob("*.py"))
        if path.relative_to(ROOT) != Path("evpinn_ros/common/writer.py")
        for line, text in creating(ast.parse(path.read_text()))
        if "os.devnull" not in text
    ]
    assert not beside
    planted = (
        *(
            "open(a, 'w')",
            "a.open('xb')",
            "a.open(mode='a')",
            "os.open(a, os.O_CREAT)",
            "a.touch()",
        ),
        *("a.write_text(b)", "shutil.copy(a, b)", "open(a, 'r+b')"),
    )
    assert all(any(creating(ast.parse(line))) for line in planted)


def test_a_file_keeps_its_permissions_and_a_new_one_has_those_of_the_umask(tmp_path):
    path = tmp_path / "car.json"
    for mode in (None, 0o600, 0o644):
        if mode is not None:
            path.chmod(mode)
        with replaced(path) as draft:
            draft.write(b"state")
        mask = os.umask(0)
        os.umask(mask)
        assert path.stat().st_mode & 0o777 == (mode or 0o666 & ~mask)


def test_a_name_as_long_as_can_be_is_written(tmp_path):
    path = tmp_path / ("x" * 255)
    with replaced(path) as draft:
        draft.write(b"state")
    assert path.read_text() == "state"


def test_links_in_a_circle_are_one_line(tmp_path):
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    with pytest.raises(OSError, match=r"circle|levels"), replaced(tmp_path / "a"):
        pass
    with pytest.raises(InputError, match=r"circle|levels"):
        check_outputs([tmp_path / "a"])


def test_no_output_is_written_over_an_input_or_another(tmp_path):
    drive, bag = tmp_path / "d.csv", tmp_path / "bag"
    drive.write_text("1")
    bag.mkdir()
    (tmp_path / "link").symlink_to(drive)
    (tmp_path / "hard").hardlink_to(drive)
    for path in (drive, tmp_path / "link", tmp_path / "hard", bag, bag / "bag_0.mcap"):
        with pytest.raises(InputError, match="over the input"):
            check_outputs([path], [drive, bag])
    with pytest.raises(InputError, match="two results"):
        check_outputs([tmp_path / "new", tmp_path / "x" / ".." / "new"], [drive])
    check_outputs([None, Path("-"), Path("/dev/null"), Path("/dev/null")], [drive])
    check_outputs([bag / "report.html", tmp_path / "new"], [drive, bag, tmp_path / "absent"])


TRACE_ME, TO_SYSTEM_CALL, DIE_WITH_PARENT = 0, 24, 1  # of ptrace, and of prctl
STOPS = 200  # a save has some 70 system calls, with a stop before and behind each


def in_child(function):
    """Start a function in a child, which ends with 0 where it returns."""
    if (child := os.fork()) == 0:
        try:
            function()
            os._exit(0)
        finally:
            os._exit(1)
    return child


def save(path, half, number):
    write_halves(path, {half: {"number": number, "bulk": [number] * 200}})


def traced_save(path, number):
    """Save a half, and stop where the file is claimed."""

    def stop_and_read(path):
        os.kill(os.getpid(), signal.SIGSTOP)
        return read_state(path)

    kernel = ctypes.CDLL(None)
    assert kernel.prctl(DIE_WITH_PARENT, signal.SIGKILL) == 0
    assert kernel.ptrace(TRACE_ME, 0, None, None) == 0
    state_file.read_state = stop_and_read
    save(path, Half.LEARNED, number)


def saved(path):
    halves = read_state(path)
    numbers = [halves[half]["number"] for half in Half]
    assert [halves[half]["bulk"] for half in Half] == [[number] * 200 for number in numbers]
    return numbers


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.skipif(sys.platform != "linux", reason="traces system calls")
@pytest.mark.parametrize(
    "kills", [range(0, STOPS, 10), pytest.param(range(10_000), marks=pytest.mark.nightly)], ids=len
)
def test_a_kill_at_each_system_call_of_a_save_loses_nothing_of_two_writers(tmp_path, kills):
    """One of two is killed at each of its stops while the other waits."""
    path, ended = tmp_path / "car.json", 0
    for half in Half:
        save(path, half, 0)
    for attempt in kills:
        killed = in_child(lambda number=attempt: traced_save(path, number))
        assert os.WIFSTOPPED(os.waitpid(killed, 0)[1])
        other = in_child(lambda number=attempt: save(path, Half.ENERGY, number))
        before, _ = saved(path)
        for _ in range(attempt % STOPS):
            ctypes.CDLL(None).ptrace(TO_SYSTEM_CALL, killed, None, None)
            if whole := os.WIFEXITED(os.waitpid(killed, 0)[1]):
                break
        else:
            whole = False
            assert saved(path)[0] in (before, attempt)
            os.kill(killed, signal.SIGKILL)
            os.waitpid(killed, 0)
        assert os.waitstatus_to_exitcode(os.waitpid(other, 0)[1]) == 0
        learned, energy = saved(path)
        assert energy == attempt and learned in ((attempt,) if whole else (before, attempt))
        ended += whole
    assert 0 < ended < len(kills) / 2
    assert names(tmp_path) == ["car.json"]


def test_what_does_not_fit_behind_a_file_is_not_appended(tmp_path):
    """Half a line that another line follows would be a damaged state."""
    (path := tmp_path / "car.json").write_text("{}")

    def append_beyond_the_limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (5, 5))
        with pytest.raises(OSError, match="No space"):
            writer.append_to(path, "\n{}{}")

    assert os.waitstatus_to_exitcode(os.waitpid(in_child(append_beyond_the_limit), 0)[1]) == 0
    assert path.read_text() == "{}"
    with pytest.raises(FileNotFoundError):
        writer.append_to(tmp_path / "absent", "\n{}")


def test_a_writer_that_waits_too_long_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "PATIENCE", 0.1)
    with claimed(tmp_path / "a"), pytest.raises(OSError, match="has been writing"):
        write_halves(tmp_path / "b", {Half.LEARNED: {}})
