"""`evpinn bench unseen` scores methods that users write."""

from pathlib import Path

import pytest

from benchmarks.unseen import run

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


def test_the_example_of_a_method_beats_the_prior():
    bags = f"{ROOT / 'bags'}=tesla_model_3_lr"
    names = "prior", f"{EXAMPLE}:LeastSquares"
    prior, mine = (run.run_task(run.Task(bags, bags, name)).scores for name in names)
    for part in ("carried", "withheld"):
        assert mine[part]["gross_mean_percent"] < prior[part]["gross_mean_percent"] / 2
