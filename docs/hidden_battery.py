"""The picture of the README: a recorded drive predicted with its battery hidden.

Run: python docs/hidden_battery.py DATA/changchun_sedan, a folder with the recordings of a
sedan in Changchun. Trips 6 to 10 are each predicted from those before them; drawn is the one whose
error of energy is the median.
"""

from pathlib import Path
import shutil
import sys
import tempfile

from matplotlib.figure import Figure
import numpy as np

import evpinn_ros as ev
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.report.figure import save_figure

ROOT = Path(__file__).resolve().parents[1]
CAR = "generic"
LEARNED = 5  # drives, before any is predicted
HIDDEN = 30.0  # s after which no voltage and no current reaches the estimator
WH, KW, MINUTE = 3600.0, 1000.0, 60.0


def main(recordings: Path) -> None:
    """Learn from drives, predict the next, draw both beside what was measured."""
    drives, results = sorted(recordings.glob("trip_*.csv.gz"))[:10], []
    with tempfile.TemporaryDirectory() as folder:
        state, copy = (Path(folder) / name for name in ("car.json", "copy.json"))
        for number, drive in enumerate(drives):
            if number >= LEARNED:
                shutil.copy(state, copy)
                results.append(ev.replay(drive, CAR, state=copy, withhold_battery_after=HIDDEN))
            ev.replay(drive, CAR, state=state)
    errors = [abs(r.metrics["withheld"]["energy"]["error_percent"]) for r in results]
    place = int(np.argsort(errors)[len(errors) // 2])
    result, number = results[place], LEARNED + place
    print(f"error of energy, %: {', '.join(f'{error:.1f}' for error in errors)}")
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    above, below = figure.subplots(2, sharex=True, height_ratios=(3, 2))
    energy, power = result.energy, result.power
    minutes = energy.index / MINUTE
    predicted = energy["predicted_j"] / WH
    half = GAUSSIAN_QUANTILE * energy["predicted_sigma_j"] / WH
    above.fill_between(minutes, predicted - half, predicted + half, alpha=0.25, lw=0)
    above.plot(minutes, predicted, label="predicted from speed, with its 90 % interval")
    above.plot(minutes, energy["measured_j"] / WH, "k--", lw=1, label="measured, hidden from it")
    above.set_ylabel("energy, Wh")
    above.legend(loc="upper left", frameon=False)
    for name, color in (("measured_w", "k"), ("smoothed_w", "tab:blue")):
        curve = power[name].dropna() / KW
        below.plot(curve.index / MINUTE, curve, color=color, lw=0.6)
    below.set_ylabel("power, kW")
    below.set_xlabel(f"minutes of {drives[number].name.split('.')[0]}, after {number} drives")
    for axes in (above, below):
        axes.axvspan(0, HIDDEN / MINUTE, color="0.9", zorder=0)
        axes.grid(alpha=0.3)
        axes.margins(x=0)
    save_figure(figure, ROOT / "docs" / "hidden_battery.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
