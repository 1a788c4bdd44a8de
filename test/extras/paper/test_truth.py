"""On drives whose car obeys eq. 21, from CAN frames to parameters: the truth is found."""

import pytest
import torch

from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.extras.paper.drive_log import read_drive_log
from evpinn_ros.extras.paper.problem import Problem, random_split
from evpinn_ros.extras.paper.scores import combination_rows, combinations, parameter_rows
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.output import write
from evpinn_ros.replays.simulation.simulate import simulate
from evpinn_ros.replays.simulation.truth_file import read_truth

pytestmark = pytest.mark.nightly


def driven(kind, vehicle, folder):
    drive = simulate(kind, vehicle, 600.0, 4, equation=RegenForm.RECOVERY)
    write(drive, folder)
    truth = read_truth(folder)
    assert truth is not None
    return read_drive_log(folder, vehicle).drive, truth


@pytest.mark.parametrize("kind", [DriveKind.URBAN, DriveKind.MIXED])
def test_eq_21_finds_the_truth(kind, vehicle, tmp_path):
    """mass/eta, C_rr and mu within 2 %, through sensors that lag, quantise and lose frames."""
    log, truth = driven(kind, vehicle, tmp_path / "drive")
    problem = Problem(log, vehicle, random_split(len(log.time), 0), dtype=torch.float64)
    z, covariance, _ = problem.fit(problem.training, problem.training.power)
    fitted = combinations(problem.values(z), vehicle.frontal_area, problem.form)
    expected = combinations(truth, vehicle.frontal_area, problem.form)
    for name in ("mass_over_eta", "c_rr", "mu"):
        assert fitted[name] == pytest.approx(expected[name], rel=0.02), name
    arguments = (vehicle, problem.values(z), covariance, problem.form)
    told = {row.name: row.prior_share for row in combination_rows(*arguments)}
    alone = {row.name: row.prior_share for row in parameter_rows(*arguments)}
    assert max(told[name] for name in ("mass_over_eta", "mu")) < 0.05
    assert min(alone[name] for name in ("mass", "c_d")) > 0.2  # the prior is needed for these
    if kind is DriveKind.URBAN:
        assert alone["c_d"] > 0.7  # in town hardly anything but the prior tells it
