"""`evpinn bench unseen` scores methods that users write."""

import json
from pathlib import Path
import signal

import numpy as np
import pytest

from benchmarks.cli import unseen as command
from benchmarks.unseen import run
from evpinn_ros.common.errors import InputError

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "methods" / "least_squares.py"
MINE = '''
"""A method of somebody else."""
from benchmarks.unseen.method import Prediction
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading

class Flat:
    """Ten kilowatts, always; a copy, which predicts, may see no battery reading."""

    def __init__(self, vehicle, is_copy=False):
        self.is_copy = is_copy

    def __deepcopy__(self, memo):
        return Flat(None, is_copy=True)

    def add_reading(self, reading):
        """Ten kilowatts."""
        assert not (self.is_copy and isinstance(reading, BatteryReading))
        if isinstance(reading, SpeedReading):
            yield Prediction(reading.stamp_ns, 1e4)

    def begin_next_drive(self):
        """Nothing to forget."""

    def combinations(self):
        """Nothing is known."""
        return {}
'''


def test_a_method_of_a_users_file_is_scored(tmp_path):
    """400 s at 20 kW; a current that never changes would be taken for not measured."""
    amperes = 2e4 / 360
    rows = (
        f"{t / 10},{15 + t % 7 / 10},360,{amperes + (t % 2 - 0.5) / 1e3}\n" for t in range(4000)
    )
    path = tmp_path / "drive.csv"
    path.write_text("t_s,speed_mps,voltage_v,current_a\n" + "".join(rows))
    (tmp_path / "mine.py").write_text(MINE)
    scores = run.run_task(
        run.Task(f"{path}=generic", f"{path}=generic", f"{tmp_path / 'mine.py'}:Flat")
    ).scores
    assert scores["carried"]["gross_mean_percent"] == pytest.approx(50.0, abs=0.1)
    assert scores["withheld"]["rmse_w"] == pytest.approx(1e4, rel=1e-6)


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_what_was_scored_is_there_before_the_next_car_and_after_a_signal(
    tmp_path, monkeypatch, end
):
    """A kill leaves as much as is read here; a car takes minutes."""
    (tmp_path / "drive.csv").write_text("")
    car, scores = f"{tmp_path / 'drive.csv'}=generic", {"true": {"mass": 1800.0}}

    def results(tasks, jobs, tell):
        yield run.TaskResult(tasks[0], "generic", 3, 1.5, scores)
        kept.append(json.loads((tmp_path / "out.json").read_text()))
        signal.raise_signal(end)

    kept = []
    monkeypatch.setattr(command, "run_tasks", results)
    with pytest.raises(KeyboardInterrupt):
        command.unseen(car, methods="prior,core", json_file=tmp_path / "out.json")
    kept.append(json.loads((tmp_path / "out.json").read_text()))
    assert [entry["cars"][car]["methods"] for entry in kept] == [{"prior": scores}] * 2


@pytest.mark.parametrize("apart", [(0.0, 0.0), (0.3, 0.6), (0.6, 0.3)])
def test_the_example_learns_also_where_voltage_and_current_are_polled_apart(tmp_path, apart):
    """Each stands in rows of its own, some tenths of a second after the speed."""
    for drive in range(2):
        rows = []
        for t in range(600):
            speed = 8 - 8 * np.cos(t / 8) + drive
            power = speed * (1000 + 1800 * np.sin(t / 8)) + 500
            cells = (0.0, 0, speed), (apart[0], 1, 360.0 - power / 4e3), (apart[1], 2, power / 340)
            for late, place, value in cells:
                row = [f"{t + late:.1f}", "", "", ""]
                row[1 + place] = f"{value:.3f}"
                rows.append((t + late, ",".join(row)))
        lines = [line for _, line in sorted(rows)]
        text = "\n".join(["t_s,speed_mps,voltage_v,current_a", *lines])
        (tmp_path / f"d{drive}.csv").write_text(text)
    car = f"{tmp_path}=generic"
    scores = run.run_task(run.Task(car, car, f"{EXAMPLE}:LeastSquares")).scores
    assert scores["carried"]["net_mean_percent"] < 10.0


def test_the_example_of_a_method_beats_the_prior():
    bags = f"{ROOT / 'bags'}=tesla_model_3_lr"
    tasks = [run.Task(bags, bags, name) for name in ("prior", f"{EXAMPLE}:LeastSquares")]
    told = []
    prior, mine = (result.scores for result in run.run_tasks(tasks, 1, told.append))
    assert told == sorted(told) and told[-1] == len(tasks) < len(told)
    for part in ("carried", "withheld"):
        assert mine[part]["gross_mean_percent"] < prior[part]["gross_mean_percent"] / 2


@pytest.mark.parametrize(
    ("power", "is_named"), [(None, True), ("float('nan')", True), ("1e4", False)]
)
def test_a_method_that_predicts_nothing_is_named(tmp_path, capsys, power, is_named):
    rows = (f"{t / 10},{15 + t % 7 / 10},360,{55 + t % 2}\n" for t in range(4000))
    (tmp_path / "drive.csv").write_text("t_s,speed_mps,voltage_v,current_a\n" + "".join(rows))
    prediction = f"yield Prediction(reading.stamp_ns, {power})" if power else "return None"
    source = MINE.replace("yield Prediction(reading.stamp_ns, 1e4)", prediction)
    (tmp_path / "mine.py").write_text(source)
    mine = f"{tmp_path / 'mine.py'}:Flat"
    command.unseen(f"{tmp_path / 'drive.csv'}=generic", methods="", method=[mine])
    few = "mine.py:Flat: predicted less than 90 % of 1 of 1 drives and 1 of 1 dropouts"
    assert (few in capsys.readouterr().out) is is_named


def test_what_a_method_lacks_and_a_folder_of_ones_own_are_refused_at_once(tmp_path):
    (tmp_path / "drive.csv").write_text("t_s,speed_mps\n")
    (tmp_path / "mine.py").write_text("class Mine:\n    def add_reading(self, reading): ...\n")
    with pytest.raises(InputError, match="Mine has no begin_next_drive, combinations"):
        run.find_method(f"{tmp_path / 'mine.py'}:Mine")
    with pytest.raises(InputError, match="recordings of your own are PATH=VEHICLE"):
        command.unseen(str(tmp_path), methods="prior")
