"""`evpinn demo`: plays a bundled drive through the three nodes, and shows what they learned."""

from __future__ import annotations

from pathlib import Path
import shutil
from typing import Annotated, Any

import typer

from evpinn_ros.bags.convert import BagReadings
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.logs import write_log
from evpinn_ros.can.profile import load_profile
from evpinn_ros.cli.console import note, progress_bar, say, show, working, write_json
from evpinn_ros.cli.interruption import Interruption
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.cli.replay import parameter_table, score_table
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.identifiable import identifiable
from evpinn_ros.replays.run import WARM_UP
from evpinn_ros.replays.scoring import drive_scores, parameter_metrics
from evpinn_ros.replays.simulation.truth_file import read_truth
from evpinn_ros.report.tables import energy_lines
from evpinn_ros.topics.node_parameters import Value

DRIVE = "urban"
VEHICLE = "tesla_model_3_lr"
RATE = 8.0  # of real time: 360 s of driving in 45 s
WORTH_SAYING = 0.02  # of the readings lost


def demo(
    out: Annotated[Path, typer.Option(help="Folder of the bag and the picture.")] = Path(
        "out/demo"
    ),
    json_file: JsonOption = None,
) -> None:
    """Play a bundled drive through the three nodes, and show what they learned.

    A simulated car drives in town. Its CAN frames go to the node `can_bridge`, and the topics of
    that node to `estimator` and `energy`; each is a separate process. The result is shown beside
    the true parameters, which the nodes do not know.

    Example: evpinn demo
    """
    # Imported here: all other commands work where no ROS is.
    from evpinn_ros.nodes.processes import record_through_nodes
    from evpinn_ros.report.figure import drive_figure, recorded_drive, save_figure

    source = share_directory() / "bags" / DRIVE
    bag, picture, log = out / "bag", out / "demo.png", out / f"{DRIVE}.log"
    if bag.exists() and not log.is_file():  # an earlier demonstration leaves a log beside it
        raise InputError(f"{bag}: exists, but evpinn demo did not write it; give another --out")
    shutil.rmtree(bag, ignore_errors=True)
    frames = _frames(source)
    with as_input_error(out):
        out.mkdir(parents=True, exist_ok=True)
    write_log(log, frames)
    end_ns, duration = frames[-1].stamp_ns, (frames[-1].stamp_ns - frames[0].stamp_ns) / 1e9
    note(f"Driving {duration:.0f} s in town at {RATE:g} times real time, through three nodes.")
    parameters: dict[str, Value] = {
        "vehicle": VEHICLE,
        "log_file": str(log),
        "log_rate": RATE,
        "wait_for_update": True,
    }
    with Interruption() as stop, progress_bar("evpinn demo", total=duration) as progress:
        record_through_nodes(parameters, end_ns, bag, progress, lambda: stop.asked)
    truth = read_truth(source)
    determined_truth = truth and identifiable(truth, load_vehicle(VEHICLE).frontal_area)
    with working(f"drawing {picture}"):
        drive = recorded_drive(bag)
        title = "A simulated drive in town, through the nodes"
        save_figure(drive_figure(drive, title, determined_truth), picture)
        scores = drive_scores(drive, WARM_UP)
    lost = 1.0 - len(drive.speed) / sum(frame.can_id == frames[0].can_id for frame in frames)
    if lost > WORTH_SAYING:
        note(
            f"evpinn: this computer was too busy for {RATE:g} times real time: {lost:.0%} of the "
            "readings were lost, so the scores are worse than usual"
        )
    show(score_table(drive, scores))
    for line in energy_lines(scores):
        say(line)
    show(parameter_table({"parameters": parameter_metrics(drive.final)}, truth))
    say(f"Picture  {picture}")
    say(f"Bag      {bag}")
    if json_file is not None:
        write_json(json_file, scores)


def _frames(source: Path) -> list[CanFrame]:
    profile = load_vehicle(VEHICLE).can_profile
    assert profile is not None, "the demonstration's car has a CAN profile"
    encoder = Encoder(load_profile(profile))
    encode: dict[type, Any] = {SpeedReading: encoder.speed, BatteryReading: encoder.battery}
    with BagReader(source) as reader:
        return [
            encode[type(reading)](reading)
            for reading in BagReadings(reader)
            if type(reading) in encode
        ]
