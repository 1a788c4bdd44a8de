"""The picture of docs/guides/viewing.md: the live view, late in a bundled drive.

Run: python docs/live_view.py (`make docs` does)
"""

import io
from pathlib import Path
import time

from rich.console import Console
from rich.terminal_theme import MONOKAI

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import new_message
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes.diagnosis import WELL, Condition
from evpinn_ros.nodes.estimator_diagnosis import estimator_status
from evpinn_ros.nodes.live.data import WATCHED, LiveData
from evpinn_ros.nodes.live.screen import screen
from evpinn_ros.replays.chain import Chain
from evpinn_ros.topics import BATTERY, DIAGNOSTICS, NAMESPACE, SPEED, topic_of
from evpinn_ros.topics.energies import output_messages
from evpinn_ros.topics.estimates import breakdown_messages
from evpinn_ros.topics.messages import diagnostics
from evpinn_ros.topics.readings import to_reading

ROOT = Path(__file__).resolve().parents[1]
VEHICLE, DRIVE = "tesla_model_3_lr", "urban"
SECONDS = 330.0  # of the drive
WIDTH, HEIGHT = 80, 24
# The frame of a terminal, without fonts from the network.
FRAME = """<svg viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>
.{unique_id}-matrix {{ font-family: monospace; font-size: {char_height}px;
    line-height: {line_height}px; white-space: pre }}
{styles}
</style>
<defs>{lines}</defs>
<rect fill="#1e1e1e" width="100%" height="100%" rx="8"/>
<g transform="translate(9, 9)">{backgrounds}<g class="{unique_id}-matrix">{matrix}</g></g>
</svg>
"""


def drive(data: LiveData) -> float:
    """Let the view hear the drive; gives the time at its end, s."""
    chain = Chain(load_vehicle(VEHICLE), EstimatorSettings(), InlineWorker(time.perf_counter))
    now = begin = 0.0
    with BagReader(share_directory() / "bags" / DRIVE) as bag:
        for record in bag.records():
            topic, now = topic_of(record.topic), record.log_time_ns / NANOSECONDS
            begin = begin or now
            if topic not in (SPEED, BATTERY) or now - begin > SECONDS:
                continue
            data.take(topic, record.message, now)
            for output in chain.add_reading(to_reading(topic.type_name, record.message)):
                for shown, message in output_messages(new_message, output):
                    if shown in WATCHED:
                        data.take(shown, message, now)
    now = begin + SECONDS
    messages = breakdown_messages(new_message, int(now * NANOSECONDS), chain.estimator.breakdown())
    for shown, message in messages:
        data.take(shown, message, now)
    condition = Condition(WELL, 0.0, 0, None)
    name, level, text, values = estimator_status(chain.estimator.status(), condition)
    status = (f"{NAMESPACE}/estimator: {name}", level, text, values)
    data.take(DIAGNOSTICS, diagnostics(new_message, int(now * NANOSECONDS), [status]), now)
    return now


def main() -> None:
    """Write docs/live_view.svg."""
    limit_blas_threads()
    data = LiveData()
    now = drive(data)
    console = Console(
        record=True, width=WIDTH, height=HEIGHT, file=io.StringIO(), force_terminal=True
    )
    console.print(screen(data, now, WIDTH, HEIGHT))
    svg = console.export_svg(title="", theme=MONOKAI, code_format=FRAME, unique_id="live")
    (ROOT / "docs" / "live_view.svg").write_text(svg, encoding="utf-8")


if __name__ == "__main__":
    main()
