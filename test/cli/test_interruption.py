"""Ctrl-C deferred: what the first and the second do, and whom it leaves alone."""

from importlib import import_module
import os
from pathlib import Path
import shutil
import signal
import sys
import tempfile

import pytest
import typer

from evpinn_ros import executables
from evpinn_ros.bags import recover, rosbags_file
from evpinn_ros.bags.types import new_message
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.cli import main as command
from evpinn_ros.cli.interruption import INTERRUPTED, Interruption
from evpinn_ros.common import stopping
from evpinn_ros.common.errors import InputError
from evpinn_ros.topics.messages import scalar


@pytest.fixture(autouse=True)
def _default_handler():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def ctrl_c() -> None:
    signal.raise_signal(signal.SIGINT)


def test_work_goes_on_to_where_it_is_whole_and_the_command_ends_with_130():
    with pytest.raises(typer.Exit) as ended, Interruption() as interruption:
        assert not interruption.asked
        ctrl_c()
        assert interruption.asked
    assert ended.value.exit_code == INTERRUPTED
    with pytest.raises(KeyboardInterrupt):  # as before
        ctrl_c()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_service_manager_and_a_closed_terminal_wait_for_results_too(number):
    with pytest.raises(typer.Exit) as ended, Interruption() as interruption:
        signal.raise_signal(number)
        assert interruption.asked
    assert ended.value.exit_code == 128 + number
    assert signal.getsignal(number) is signal.SIG_DFL


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_what_a_shell_and_the_kernel_both_send_interrupts_no_saving(number):
    saved = []
    with pytest.raises(typer.Exit) as ended, Interruption():
        for _ in range(3):
            signal.raise_signal(number)
        signal.raise_signal(signal.SIGTERM)
        saved.append("state")
    assert saved and ended.value.exit_code == 128 + number


def test_without_ctrl_c_nothing_happens():
    with Interruption():
        pass
    with pytest.raises(InputError), Interruption():
        raise InputError("wrong")


def test_a_second_one_does_not_wait():
    with pytest.raises(KeyboardInterrupt), Interruption():
        ctrl_c()
        ctrl_c()


def test_an_input_that_gave_nothing_yet_is_told(capsys):
    with pytest.raises(typer.Exit), Interruption():
        ctrl_c()
        raise InputError("drive.csv: holds no vehicle/speed")
    assert capsys.readouterr().err == "evpinn: stopped: drive.csv: holds no vehicle/speed\n"


def test_a_mistake_of_ours_is_not_hidden():
    with pytest.raises(ZeroDivisionError), Interruption():
        ctrl_c()
        raise ZeroDivisionError


def test_where_it_is_ignored_it_stays_ignored():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with Interruption() as interruption:
        ctrl_c()
        assert not interruption.asked
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


ALL_LINES = 98


STARTING = (executables, command, stopping)


def _interrupted_at(number: int, stderr: Path, words=("--version",), modules=STARTING) -> int:
    """Exit code of `evpinn` in a fork that gets SIGINT at a line of some modules.

    Lines count from the first handler on; `ALL_LINES` if there are fewer.
    """
    files = {module.__file__ for module in modules}
    left = [number]

    def trace(frame, event, _):
        if frame.f_code.co_filename not in files:
            return None
        begun = modules is not STARTING or left[0] < number
        begun = begun or signal.getsignal(signal.SIGINT) != signal.default_int_handler
        if event == "line" and begun:
            left[0] -= 1
            if left[0] == 0:
                signal.raise_signal(signal.SIGINT)
        return trace

    if (child := os.fork()) == 0:
        code = 99
        try:
            with stderr.open("w") as sys.stderr, Path(os.devnull).open("w") as sys.stdout:
                sys.argv = ["evpinn", *map(str, words)]
                sys.settrace(trace)
                executables.evpinn()
        except SystemExit as ended:
            code = ALL_LINES if left[0] > 0 else ended.code or 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.slow
def test_no_line_of_the_start_and_the_end_shows_a_traceback(tmp_path):
    """The command ends with 130 until its result is there, and then as it would."""
    codes = []
    while not codes or codes[-1] != ALL_LINES:
        codes.append(_interrupted_at(len(codes) + 1, tmp_path / "stderr"))
        assert (tmp_path / "stderr").read_text() == ""
    assert len(codes) > 20 and {*codes[:-1]} == {INTERRUPTED, 0}
    assert codes[:-1] == sorted(codes[:-1], reverse=True)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("words", ["recover {0} {1}", "compare {0} {0}"])
def test_no_line_of_a_bags_reading_and_of_its_folder_shows_a_traceback(tmp_path, words):
    """Nor is there a half bag: the folder of the new one is removed, or empty, or whole."""
    with BagWriter(tmp_path / "bag") as bag:
        for second in range(5):
            message = scalar(new_message, float(second))
            bag.write("/ev/battery/voltage", message, second * 10**9)
    new, modules = tmp_path / "new", (recover, rosbags_file, tempfile)
    command_words = words.format(tmp_path / "bag", new).split()
    import_module(f"evpinn_ros.cli.{command_words[0]}")  # once, before the forks
    number, codes = 1, []
    while ALL_LINES not in codes:
        codes.append(_interrupted_at(number, tmp_path / "stderr", command_words, modules))
        number += 1 + number // 2
        said = (tmp_path / "stderr").read_text()
        assert "Traceback" not in said and (codes[-1] != INTERRUPTED or said == "")
        if new.exists() and any(new.iterdir()):
            assert (new / "metadata.yaml").exists()
            shutil.rmtree(new)
    assert len(codes) > 5 and codes[0] == INTERRUPTED
