"""The picture of the README: a bundled drive predicted with its battery hidden.

Run: python docs/hidden_battery.py (`make docs` does)
"""

from pathlib import Path
import tempfile

from matplotlib.figure import Figure

import evpinn_ros as ev
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.report.figure import save_figure

ROOT = Path(__file__).resolve().parents[1]
CAR = "tesla_model_3_lr"
HIDDEN = 30.0  # s after which no voltage and no current reaches the estimator
WH, KW, MINUTE = 3600.0, 1000.0, 60.0


def main() -> None:
    """Learn from one drive, predict another, draw both beside what was measured."""
    with tempfile.TemporaryDirectory() as folder:
        state = Path(folder) / "car.json"
        ev.replay(ROOT / "bags" / "urban", CAR, state=state)
        drive = ev.replay(
            ROOT / "bags" / "highway", CAR, state=state, withhold_battery_after=HIDDEN
        )
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    above, below = figure.subplots(2, sharex=True, height_ratios=(3, 2))
    energy, power = drive.energy, drive.power
    minutes = energy.index / MINUTE
    predicted = energy["predicted_j"] / WH
    half = GAUSSIAN_QUANTILE * energy["predicted_sigma_j"] / WH
    above.fill_between(minutes, predicted - half, predicted + half, alpha=0.25, lw=0)
    above.plot(minutes, predicted, label="predicted from speed, with its 90 % interval")
    above.plot(minutes, energy["measured_j"] / WH, "k--", lw=1, label="measured, hidden from it")
    above.set_ylabel("energy, Wh")
    above.legend(loc="upper left", frameon=False)
    for name, style in (("smoothed_w", "tab:blue"), ("measured_w", "k")):
        below.plot(power.index / MINUTE, power[name] / KW, color=style, lw=0.8)
    below.set_ylabel("power, kW")
    below.set_xlabel("minutes of a drive on the motorway, after a drive of six minutes in town")
    for axes in (above, below):
        axes.axvspan(0, HIDDEN / MINUTE, color="0.9", zorder=0)
        axes.grid(alpha=0.3)
        axes.margins(x=0)
    save_figure(figure, ROOT / "docs" / "hidden_battery.png")


if __name__ == "__main__":
    main()
