"""Reading a log for the experiment: the same gates as on the road, and clear refusals."""

import numpy as np
import pytest
import torch

from evpinn_ros.can.logs import write_log
from evpinn_ros.common.errors import InputError
from evpinn_ros.extras.paper.drive_log import read_drive_log, speed_delay
from evpinn_ros.extras.paper.problem import Problem, random_split
from evpinn_ros.extras.paper.scores import combinations
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate
from test.extras.paper.conftest import TRUE


def write_csv(path, log, rows=slice(None), delay=0.0):
    """A drive's CSV; speed stamped `delay` s later than it was."""
    speed = np.interp(log.time - delay, log.time, log.speed)
    columns = zip(log.time[rows], speed[rows], log.power[rows], strict=True)
    lines = [f"{t:.3f},{v:.6f},{p:.3f}" for t, v, p in columns]
    path.write_text("\n".join(["t_s,speed_mps,power_w", *lines]) + "\n")
    return path


def test_log_is_read_with_its_acceleration(tmp_path, make_log, vehicle):
    log = make_log(noise=0.0)
    read = read_drive_log(write_csv(tmp_path / "a.csv", log), vehicle).drive
    assert len(read.time) > 380
    problem = Problem(read, vehicle, random_split(len(read.time), 0), dtype=torch.float64)
    fit = problem.fit(problem.training, problem.training.power)
    fitted = combinations(problem.values(fit.log_scale), vehicle.frontal_area, problem.form)
    truth = combinations(TRUE, vehicle.frontal_area, problem.form)
    assert fitted["mass_over_eta"] == pytest.approx(truth["mass_over_eta"], rel=0.02)
    assert fitted["mu"] == pytest.approx(truth["mu"], rel=0.02)
    assert all(np.isfinite(column).all() for column in read)


@pytest.mark.parametrize("delay", [-0.12, 0.0, 0.2])
def test_delay_of_speed_is_found(delay, tmp_path, make_log, vehicle):
    log = make_log()
    late = log._replace(
        speed=np.interp(log.time - delay, log.time, log.speed),
        acceleration=np.interp(log.time - delay, log.time, log.acceleration),
    )
    assert speed_delay(late, vehicle) == pytest.approx(delay, abs=0.03)


def test_time_that_goes_back_is_refused(tmp_path, vehicle):
    """Two drives in one CAN log, the second with the stamps of the first."""
    frames = simulate(DriveKind.URBAN, vehicle, 30.0, 1).frames
    write_log(tmp_path / "twice.log", [*frames, *frames])
    with pytest.raises(InputError, match=r"twice\.log: time goes back"):
        read_drive_log(tmp_path / "twice.log", vehicle)
