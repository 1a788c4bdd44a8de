"""Ctrl-C deferred: what the first and the second do, and whom it leaves alone."""

import signal

import pytest
import typer

from evpinn_ros.cli.interruption import INTERRUPTED, Interruption
from evpinn_ros.common.errors import InputError


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
