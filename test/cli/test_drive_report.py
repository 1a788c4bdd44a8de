"""The report of a live drive, from the bag that the nodes would have left."""

import os
from pathlib import Path
import shutil
import signal
import threading

import pytest
import typer

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.cli.run import _say_what_is_kept, learned_before, reported
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.package_data import share_directory
from test.waiting import wait_until

URBAN = share_directory() / "bags" / "urban"
OPTIONS = ("--vehicle", "tesla_model_3_lr", "--duration", "20")


@pytest.mark.parametrize("heard", [True, False])
def test_a_drive_of_no_readings_is_not_offered_for_replay(tmp_path, capsys, heard):
    bag = tmp_path / "today"
    with BagWriter(bag) as writer:
        topic = "/ev/vehicle/speed" if heard else "/diagnostics"
        writer.write_raw(topic, "std_msgs/msg/Float64", bytes(12), 1)
    _say_what_is_kept(0.0, "bmw_i3", bag, None)
    said = capsys.readouterr().err
    assert ("evpinn replay" in said) == heard and ("nothing to replay" in said) != heard


def test_a_drive_that_was_not_to_be_kept_leaves_its_report_alone(tmp_path):
    report, state = tmp_path / "new" / "drive.html", tmp_path / "car.json"
    with reported(report, None, state, OPTIONS) as bag:
        shutil.copytree(URBAN, bag)
    assert list(report.parent.iterdir()) == [report]
    assert "tesla_model_3_lr" in report.read_text() and not state.exists()


def test_a_recording_stays_and_what_cannot_be_reported_fails(tmp_path):
    record, state = tmp_path / "today", tmp_path / "car.json"
    record.mkdir()  # an empty folder may become the bag
    state.write_text("{}")
    with (
        pytest.raises(typer.Exit) as ended,
        reported(tmp_path / "drive.html", record, state, OPTIONS) as bag,
    ):
        shutil.copytree(URBAN, bag, dirs_exist_ok=True)
    assert ended.value.exit_code == 1 and bag == record
    assert {path.name for path in tmp_path.iterdir()} == {"today", "car.json"}
    assert state.read_text() == "{}", "what the nodes wrote is not overwritten"


def test_a_drive_outlives_a_report_that_fails(tmp_path):
    with (
        pytest.raises(typer.Exit),
        reported(tmp_path / "drive.html", None, None, ("--vehicle", "none")) as bag,
    ):
        shutil.copytree(URBAN, bag)
    [kept] = tmp_path.iterdir()
    with BagReader(kept) as reader:
        assert any(reader.log_times())


def test_a_report_that_has_no_place_is_refused_before_the_drive(tmp_path):
    with pytest.raises(InputError, match="a folder"), reported(tmp_path, None, None, OPTIONS):
        pass
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(InputError, match="file"),
        reported(tmp_path / "file" / "drive.html", None, None, OPTIONS),
    ):
        pass


def test_sigterm_cuts_the_report_short_and_keeps_the_drive(tmp_path, tmp_path_factory):
    """Whoever sends it, systemd say, kills us a while later: the drive would be lost.

    At its own rate the drive of six minutes takes longer than a test may.
    """
    handler, beside = signal.getsignal(signal.SIGTERM), tmp_path_factory.mktemp("beside")
    options = (*OPTIONS[:2], "--rate", "1", "--out", str(beside / "bag"))

    def terminate():
        wait_until(lambda: [*beside.iterdir()])  # the drive is being replayed
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=terminate)
    thread.start()
    with (
        pytest.raises(typer.Exit) as ended,
        reported(tmp_path / "drive.html", None, None, options) as bag,
    ):
        shutil.copytree(URBAN, bag)
    assert ended.value.exit_code in (130, 143)
    assert signal.getsignal(signal.SIGTERM) is handler
    thread.join()
    (kept,) = (path for path in tmp_path.iterdir() if path.is_dir())
    with BagReader(kept) as reader:
        assert any(reader.log_times())


def test_the_report_starts_from_the_state_that_the_nodes_start_from(tmp_path):
    params, other = tmp_path / "params.yaml", tmp_path / "other.json"
    params.write_text("/**/estimator:\n  ros__parameters:\n    state_file: ~/car.json\n")
    assert learned_before(None, params) == Path("~/car.json").expanduser()
    assert learned_before(other, params) == other
    assert learned_before(None, None) is None
    params.write_text("/**/estimator:\n  ros__parameters:\n    vehicle: bmw_i3\n")
    assert learned_before(None, params) is None
