"""Drives on disk: the bag, the truth, the CAN log, the command, and the bags of this project."""

from dataclasses import astuple
from functools import cache
from pathlib import Path
import resource

import numpy as np
import pytest
import typer
from typer.testing import CliRunner
import yaml

from evpinn_ros.bags.convert import BagReadings
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.logs import LogFile
from evpinn_ros.can.profile import load_profile
from evpinn_ros.cli.simulate import simulate as command
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.signals.readings import Reading
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.replays.simulation.output import write

pytestmark = pytest.mark.slow

BAGS = share_directory() / "bags"
app = typer.Typer()
app.command()(command)


def run(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@cache
def readings_of(bag: Path) -> list[Reading]:
    with BagReader(bag) as reader:
        return list(BagReadings(reader))


def bundled_arguments(name: str) -> list[str]:
    """The arguments after OUT of the command in bags/README.md that made this bag."""
    lines = (BAGS / "README.md").read_text().replace("\\\n", " ").splitlines()
    (line,) = [line for line in lines if line.startswith(f"evpinn simulate bags/{name} ")]
    return line.split()[3:]


@pytest.fixture(scope="module")
def written(urban, tmp_path_factory) -> Path:
    """A drive as a bag and as a CAN log."""
    bag = tmp_path_factory.mktemp("written") / "drive"
    write(urban, bag, bag.with_suffix(".log"))
    return bag


def test_the_bag_holds_the_readings(urban, written):
    kept = readings_of(written)
    assert [type(reading) for reading in kept] == [type(reading) for reading in urban.readings]
    for kind in {*map(type, kept)}:  # BatteryState holds 32 bits
        here, there = (
            np.array(
                [astuple(reading) for reading in readings if type(reading) is kind], dtype=float
            )
            for readings in (kept, urban.readings)
        )
        assert here == pytest.approx(there, rel=1e-6, nan_ok=True)


def test_the_truth_lies_beside_the_bag(urban, written):
    truth = yaml.safe_load((written / "truth.yaml").read_text())
    assert truth["parameters"] == pytest.approx(urban.truth.parameters._asdict(), rel=1e-5)
    assert truth["identifiable"] == pytest.approx(urban.truth.identifiable._asdict(), rel=1e-5)
    assert tuple(truth["definitions"]) == PARAMETER_NAMES
    assert (truth["vehicle"], truth["seed"], truth["duration_s"]) == ("tesla_model_3_lr", 1, 240)


def test_the_can_log_decodes_to_the_same_readings(urban, written):
    decoder = Decoder(load_profile("tesla_model_3"))
    frames = LogFile(written.with_suffix(".log")).frames()
    decoded = [reading for frame in frames for reading in decoder.decode(frame)]
    assert repr(decoded) == repr(list(urban.readings))


def test_a_full_disk_leaves_no_part_of_a_drive(urban, tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        with pytest.raises(InputError, match="File too large; it was removed"):
            write(urban, tmp_path / "drive")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not [*tmp_path.iterdir()]


def test_command(tmp_path):
    out = tmp_path / "drive"
    result = run(out, "--duration", 60, "--kind", "mixed", "--true", "mass=2000", "--hills", 0)
    assert result.exit_code == 0, result.output
    assert "mass" in result.stdout and "2000" in result.stdout and str(out) in result.stdout
    truth = yaml.safe_load((out / "truth.yaml").read_text())
    assert (truth["kind"], truth["parameters"]["mass"]) == ("mixed", 2000)
    assert truth["hidden"]["rms_grade"] == 0


@pytest.mark.parametrize("name", ["urban", "highway"])
def test_a_bundled_bag_is_made_again_to_the_bit(name, tmp_path):
    assert run(tmp_path / name, *bundled_arguments(name)).exit_code == 0
    made, kept = (readings_of(root / name) for root in (tmp_path, BAGS))
    assert repr(made) == repr(kept)
    truth = [(root / name / "truth.yaml").read_text() for root in (tmp_path, BAGS)]
    assert truth[0] == truth[1]
