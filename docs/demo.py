"""The picture of the README: a bundled drive replayed, beside what truly happened in it.

Run: python docs/demo.py (`make docs` does)
"""

from dataclasses import replace
from pathlib import Path
import sys
import time

import yaml

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # the benchmarks lie beside the package

from benchmarks.breakdown import SpanChain, true_parts  # noqa: E402
from evpinn_ros.core.estimation.breakdown import JOULES_PER_KWH  # noqa: E402
from evpinn_ros.core.estimation.estimator import EstimatorSettings  # noqa: E402
from evpinn_ros.core.estimation.worker import InlineWorker  # noqa: E402
from evpinn_ros.core.vehicle.files import load_vehicle  # noqa: E402
from evpinn_ros.logs.sources import open_source  # noqa: E402
from evpinn_ros.replays.chain import Chain  # noqa: E402
from evpinn_ros.replays.run import ReplayOptions, replay  # noqa: E402
from evpinn_ros.replays.simulation.drive import DriveKind  # noqa: E402
from evpinn_ros.replays.simulation.simulate import simulate  # noqa: E402
from evpinn_ros.report.figure import drive_figure, save_figure  # noqa: E402

BAG = ROOT / "bags" / "urban"


def main() -> None:
    """Replay the bag, drive the same car again for its ledger, draw both."""
    truth = yaml.safe_load((BAG / "truth.yaml").read_text(encoding="utf-8"))
    vehicle, settings = load_vehicle(truth["vehicle"]), EstimatorSettings()
    chain = Chain(vehicle, settings, InlineWorker(time.perf_counter))
    names = {"vehicle": vehicle.key, "mode": settings.mode.value}
    drive = replay(open_source(BAG, vehicle), chain, ReplayOptions(), **names).drive

    seconds, kind = truth["duration_s"], DriveKind(truth["kind"])
    again = simulate(kind, vehicle, seconds, truth["seed"], car=truth["parameters"])
    spans = SpanChain(vehicle)
    for reading in again.readings:
        spans.add_reading(reading)
    found = spans.breakdown
    assert found is not None, "a drive of minutes has a breakdown"
    amounts = found.amounts()
    drive = replace(drive, breakdown={n: (a.kwh, a.sigma_kwh) for n, a in amounts.items()})
    parts = true_parts(again.car, again.trace, spans.spans)
    true_kwh = {name: energy / JOULES_PER_KWH for name, energy in parts.items()}
    title = "Six minutes in town of a simulated car, whose truth no estimator knows"
    figure = drive_figure(drive, title, again.truth.identifiable, true_kwh)
    save_figure(figure, ROOT / "docs" / "demo.png")


if __name__ == "__main__":
    main()
